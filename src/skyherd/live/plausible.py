"""Physical ranges of received messages, and the ids that a lab knows.

A message of the right shape may hold values that no camera gives, such as a goal at 1e200 px. Products and
squares of such values are not finite. The ranges are far above real values and refuse no real message.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from skyherd.errors import MessageError
from skyherd.messages import FlightCommand, MotionGoals, Proximity, Sighting, UnitReport
from skyherd.messages.ids import NO_ID
from skyherd.messages.role_map import RoleMap
from skyherd.messages.tree_status import TreeStatus

MAX_PX = 1e6
"""Largest coordinate or length in an image, px. Chosen: ten times the side of the largest picture file."""

MIN_SIDE_PX = 0.1
"""Shortest side of a marker in an image, px. Chosen: no detector finds markers of one pixel."""

MAX_SIDES = 1e6
"""Largest length, marker sides. Chosen: `MAX_PX` over a side of one pixel."""

MAX_RAD = 10.0
"""Largest angle, rad. Chosen: above one turn."""

MAX_SPEED = 1e3
"""Largest speed or turn rate, m/s or rad/s. Chosen: above any robot or flying unit."""

MAX_COUNT = 2.0**53
"""Largest counter. Derived: every JSON reader keeps integers up to it."""

RANGES: Mapping[type, Mapping[str, tuple[float, float]]] = {
    MotionGoals: {
        "rho_px": (0.0, MAX_PX),
        "bearings_rad": (-MAX_RAD, MAX_RAD),
        "sides_px": (MIN_SIDE_PX, MAX_PX),
        "neighbor_distances_px": (0.0, MAX_PX),
    },
    Proximity: {
        "horizon_sides": (0.0, MAX_SIDES),
        "distances_sides": (0.0, MAX_SIDES),
        "bearings_rad": (-MAX_RAD, MAX_RAD),
        "reaches_sides": (0.0, MAX_SIDES),
        "shares": (0.0, 1.0),
        "ways_sides": (0.0, MAX_SIDES),
    },
    UnitReport: {
        "image_size_px": (1.0, MAX_PX),
        "points_px": (-MAX_PX, MAX_PX),
        "cost_sides2": (0.0, MAX_SIDES**2),
        "side_px": (0.0, MAX_PX),
    },
    TreeStatus: {
        "ask_turn": (-MAX_COUNT, MAX_COUNT),
        "turns": (-MAX_COUNT, MAX_COUNT),
        "handed_slots": (-MAX_COUNT, MAX_COUNT),
    },
    RoleMap: {"version": (0.0, MAX_COUNT)},
    Sighting: {
        "centers_px": (-MAX_PX, MAX_PX),
        "headings_rad": (-MAX_RAD, MAX_RAD),
        "sides_px": (MIN_SIDE_PX, MAX_PX),
    },
    FlightCommand: {
        "lateral_mps": (-MAX_SPEED, MAX_SPEED),
        "climb_mps": (-MAX_SPEED, MAX_SPEED),
        "yaw_rate_radps": (-MAX_SPEED, MAX_SPEED),
    },
}
"""Smallest and largest value of fields, by the class of a message or of its part."""


def check_ranges(message: object) -> None:
    """Refuse a message with a value outside its range.

    Raises:
        MessageError: a value is outside; the text names the field.
    """
    for name, (low, high) in RANGES.get(type(message), {}).items():
        values = np.asarray(getattr(message, name))
        if values.size and not (low <= values.min() and values.max() <= high):
            raise MessageError(name, "is out of range", f"{low:g} to {high:g}")
    if isinstance(message, UnitReport):
        check_ranges(message.tree)
        check_ranges(message.roles)


@dataclass(frozen=True)
class Roster:
    """Ids that a lab knows.

    Attributes:
        robots: ids of its robots.
        units: numbers of its units; None if they are not known.
    """

    robots: frozenset[int]
    units: frozenset[int] | None = None

    def unknown_in(self, report: UnitReport) -> str | None:
        """Return the field of a report that names an unknown robot or unit, or None."""
        tree = report.tree
        robots = {name: getattr(report, name) for name in ("ids", "controlled_ids", "secure_ids")}
        units: dict[str, Iterable[int]] = {"unit_id": [report.unit_id]}
        if report.roles is not None:
            if report.roles.roles.size != len(self.robots):
                return "roles"
            units["roles.author_id"] = [report.roles.author_id]
        if tree is not None:
            names = ("pairs", "offered_ids", "to_release_ids", "missing_ids", "handed_ids", "accepted_ids")
            robots |= {name: getattr(tree, name).ravel() for name in names}
            units |= {
                name: getattr(tree, name) for name in ("neighbor_ids", "offered_to_ids", "handed_to_ids")
            }
            units |= {name: [getattr(tree, name)] for name in ("tree_id", "asks_id", "heir_id")}
        for name, ids in robots.items():
            if not self.robots.issuperset(set(ids.tolist()) - {NO_ID}):
                return name
        for name, numbers in units.items():
            if self.units is not None and not self.units.issuperset(set(map(int, numbers)) - {NO_ID}):
                return name
        return None
