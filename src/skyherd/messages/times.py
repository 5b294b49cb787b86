"""Tolerance for the comparison of times."""

TIME_TOLERANCE_S = 1e-9
"""Times that differ by less than this are equal, s. Derived: far above the rounding of a day (86 400 s x
2^-53 = 1e-11 s) and far below the shortest time step (1e-4 s)."""
