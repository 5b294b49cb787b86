"""The slot clock: time cut into slots of equal length, common to all units.

Units exchange robots, and make new role maps, only in the first image of a slot, so that a topology lasts for
at least a slot (the dwell time of the paper's Proposition 1), and take turns by the number of the slot.
Repairs act at once: failover, disputed robots, leaving a tree, founding one when asked, received role maps.
"""

from math import floor

TOLERANCE = 1e-9
"""A time so close before the beginning of a slot belongs to that slot, in slots. Derived: above the rounding
of the quotient of a time of a day and a slot of 0.1 s (86 400 / 0.1 x 2^-53 = 1e-10), far below a frame."""


def slot_at(time_s: float, slot_s: float) -> int:
    """Number of the slot of length `slot_s` that `time_s` falls in: `floor(t / T)`, 0 from time 0 on."""
    return floor(time_s / slot_s + TOLERANCE)
