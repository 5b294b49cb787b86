"""Slot clock: time divided into slots of equal length, common to all units.

Units exchange robots and create role maps only in the first image of a slot. A topology therefore lasts at
least one slot (the dwell time of the paper's Proposition 1). Units take turns by the number of the slot.
Repairs are immediate: failover, disputed robots, leaving a tree, founding one on request, received role maps.
"""

from math import floor

TOLERANCE = 1e-9
"""A time this close before the start of a slot belongs to that slot, in slots. Derived: above the rounding of
a day over a slot of 0.1 s (86 400 / 0.1 x 2^-53 = 1e-10), far below a frame."""


def slot_at(time_s: float, slot_s: float) -> int:
    """Return the number of the slot of length `slot_s` that contains `time_s`: `floor(t / T)`."""
    return floor(time_s / slot_s + TOLERANCE)
