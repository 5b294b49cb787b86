"""The slot clock: time cut into slots of equal length, common to all units.

Control sets and roles change only in the first image of a slot, so that every topology lasts for at least a
slot (the dwell time of the paper's Proposition 1), and units take turns by the number of the slot.
"""

from math import floor

ROUNDING = 1e-9
"""Share of a slot by which a time may fall short of the slot's start. Derived: times are sums of at most 10^6
steps, each rounded to 1e-16 of the total, and no time step is as short as 1e-9 of a slot."""


def slot_at(time_s: float, slot_s: float) -> int:
    """Number of the slot of length `slot_s` that `time_s` falls in: `floor(t / T)`, 0 from time 0 on."""
    return floor(time_s / slot_s + ROUNDING)
