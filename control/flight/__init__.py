"""How a unit flies, from image quantities alone."""
