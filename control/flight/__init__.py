"""Flight laws of a unit, from image quantities alone."""
