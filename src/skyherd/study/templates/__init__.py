"""Templates of the studies' pages."""
