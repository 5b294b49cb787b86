"""How exactly two times can be compared."""

TIME_TOLERANCE_S = 1e-9
"""Times that differ by less than this are the same, s.

Times are multiples of a time step, or sums of such, in double precision. Derived: rounding moves a time of a
day (86 400 s, the longest mission) by no more than a few times 86 400 s x 2^-53 = 1e-11 s; the tolerance is
far above that, and far below any time step (the shortest in use is 1e-4 s).
"""
