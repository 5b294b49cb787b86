"""Studies: one scenario run many times, with parameters on a grid or drawn at random."""
