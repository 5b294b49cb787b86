"""Identities of robots whose id a unit saw at several places of one image.

A robot's marker may exist twice, for example on a spare sheet on the ground. A unit cannot read from one
image which of the two is the robot. The id is then ambiguous: the unit sends no goal for its shape, and both
places are bodies without identity (`skyherd.control.avoidance.proximity`).

The robot is told apart by motion: it obeys. The unit asks it to turn to the left in place (`Turns`). The
robot is the marker that turns by `TURNED_RAD` while all others with its id are at rest (`Copies`). Markers
keep their roles from image to image by their places.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np

from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, to_complex, wrap_angle
from skyherd.messages import Detections, MotionGoals

AMBIGUOUS_S = 2.0
"""Time for which an id stays ambiguous after it was last seen at two places, s. Chosen: ten images at 5 Hz,
so that a missed detection of the robot does not turn the other marker into the robot."""

TURNED_RAD = 1.5
"""Turn to the left by which a marker obeys, rad. Chosen: half a second at 3 rad/s, and far above the yaw of a
camera in that time."""

RESTED_RAD = 0.3
"""Turn up to which the other markers of the id are at rest, rad. Chosen: a fifth of `TURNED_RAD`."""

SAME_PLACE_SIDES = 1.0
"""Maximum motion of a marker between two images, marker sides. Chosen: six times that of a robot at 1.5 sides
a second and 10 images a second. Two bodies do not come so close."""

ASKED_S, PAUSE_S = 10.0, 30.0
"""Time for which a unit asks a robot to turn, and until it asks again, s. Chosen: a robot at 0.3 rad/s turns
by `TURNED_RAD` in half of the first. A robot outside the image turns for a quarter of the time."""

TURN_SIDES = 0.25
"""Length of the goal that makes a robot turn, marker sides. Chosen: the robot creeps by a fraction of its
side, even if its law drives before it faces the goal."""

COPY_ID = 1_000_000
"""Offset between the id of a robot and the id under which its copies are listed. Chosen: above the ids of all
dictionaries, so that a copy is a body without identity."""


class AmbiguousIds:
    """Monitor of the ids that were recently at several places of one unit's images."""

    def __init__(self) -> None:
        self._repeated_s: dict[int, float] = {}

    def update(self, detections: Detections) -> frozenset[int]:
        """Return the ids that are ambiguous at the time of an image.

        Args:
            detections: all markers of the image, on the unit's own clock.
        """
        now_s = detections.time_s
        for marker in sorted(detections.repeated_ids):
            self._repeated_s[marker] = now_s
        self._repeated_s = {
            marker: last_s for marker, last_s in self._repeated_s.items() if now_s - last_s <= AMBIGUOUS_S
        }
        return frozenset(self._repeated_s)


class Turns:
    """Requests of a unit to robots with ambiguous ids to turn to the left in place."""

    def __init__(self) -> None:
        self._since_s: dict[int, float] = {}

    def ask(self, detections: Detections, ambiguous: Iterable[int]) -> MotionGoals | None:
        """Return the goals that make robots turn, or None if no robot has to.

        Args:
            detections: all markers of the image.
            ambiguous: robots that are to be told apart.
        """
        now_s, seen = detections.time_s, set(detections.ids.tolist())
        self._since_s = {robot: self._since_s.get(robot, now_s) for robot in sorted(ambiguous)}
        asked = [
            robot
            for robot, since_s in self._since_s.items()
            if robot in seen and (now_s - since_s) % (ASKED_S + PAUSE_S) < ASKED_S
        ]
        if not asked:
            return None
        sides_px = np.array([detections.sides_px[detections.ids == robot].mean() for robot in asked])
        return MotionGoals(
            unit_id=detections.unit_id,
            time_s=now_s,
            ids=np.array(asked, dtype=np.int64),
            rho_px=TURN_SIDES * sides_px,
            bearings_rad=np.full(sides_px.size, np.pi / 2),
            sides_px=sides_px,
            neighbor_ids=np.zeros((sides_px.size, 0), dtype=np.int64),
            neighbor_distances_px=np.zeros((sides_px.size, 0)),
        )


@dataclass(frozen=True)
class _Places:
    """Places of one id's K markers.

    Attributes:
        points_px: (K,) centres.
        headings_rad: (K,) headings in the image.
        turned_rad: (K,) turns to the left since all K were seen in each image; not below 0.
        seen_s: (K,) times of the last images with them.
        is_robot: (K,) the robot, once it is told apart; at most one.
        is_copy: (K,) its copies.
    """

    points_px: ComplexArray
    headings_rad: Array
    turned_rad: Array
    seen_s: Array
    is_robot: BoolArray
    is_copy: BoolArray

    @classmethod
    def unknown(cls, seen: Detections) -> "_Places":
        """Return the places of markers that are not told apart."""
        count = len(seen)
        return cls(
            points_px=to_complex(seen.centers_px),
            headings_rad=seen.headings_rad,
            turned_rad=np.zeros(count),
            seen_s=np.full(count, seen.time_s),
            is_robot=np.zeros(count, dtype=bool),
            is_copy=np.zeros(count, dtype=bool),
        )

    def take(self, at: IntArray | BoolArray) -> "_Places":
        """Return the places at indices or in a mask."""
        return _Places(*(getattr(self, field.name)[at] for field in fields(self)))

    def joined(self, other: "_Places") -> "_Places":
        """Return these places, then the others."""
        pairs = ((getattr(self, field.name), getattr(other, field.name)) for field in fields(self))
        return _Places(*map(np.concatenate, pairs))

    def follow(self, seen: Detections) -> "_Places":
        """Return the places after an image, first those of its N markers.

        A marker has the role of the nearest place within `SAME_PLACE_SIDES`. Without one its role is unknown,
        and turns are counted from 0. Places that are not seen are kept for `AMBIGUOUS_S`.
        """
        # Imported here: it takes 0.08 s, and few runs need it.
        from scipy.optimize import linear_sum_assignment

        points_px = to_complex(seen.centers_px)
        away = np.abs(points_px[:, None] - self.points_px) / seen.sides_px[:, None]
        marker, place = linear_sum_assignment(np.minimum(away, SAME_PLACE_SIDES))
        near = away[marker, place] < SAME_PLACE_SIDES
        marker, place = marker[near], place[near]
        left_rad = -wrap_angle(seen.headings_rad[marker] - self.headings_rad[place])
        now = _Places.unknown(seen)
        now.is_robot[marker], now.is_copy[marker] = self.is_robot[place], self.is_copy[place]
        if marker.size == len(seen) == self.seen_s.size:
            now.turned_rad[marker] = np.maximum(self.turned_rad[place] + left_rad, 0.0)
        lost = np.ones(self.seen_s.size, dtype=bool)
        lost[place] = False
        lost &= self.seen_s >= seen.time_s - AMBIGUOUS_S
        kept = replace(self, turned_rad=np.zeros(self.seen_s.size)).take(lost)
        return now.joined(kept)

    def judged(self) -> "_Places":
        """Return the places with the robot told apart, if one marker obeys and all others are at rest.

        Beside a robot in the same image, markers of unknown role are copies.
        """
        obeys, rests = self.turned_rad >= TURNED_RAD, self.turned_rad <= RESTED_RAD
        if obeys.sum() == 1 and (obeys | rests).all() and self.turned_rad.size > 1:
            return replace(self, is_robot=obeys, is_copy=~obeys)
        seen = self.seen_s == self.seen_s.max(initial=-np.inf)
        robot_is_seen = bool((self.is_robot & seen).any())
        return replace(self, is_copy=self.is_copy | (seen & ~self.is_robot & robot_is_seen))


class Copies:
    """Tracker of markers with a repeated id in one unit's images, which tells the robot from its copies."""

    def __init__(self) -> None:
        self._places: dict[int, _Places] = {}
        self._before: Detections | None = None

    def relabel(self, detections: Detections) -> Detections:
        """Return the detections, with copies of a robot under the id `COPY_ID` plus the robot's id.

        Ids whose markers are not told apart keep their repeated id.

        Args:
            detections: all markers of the image.
        """
        repeated = detections.repeated_ids
        last, self._before = self._before, detections
        if last is None or not (repeated or self._places):
            return detections
        shift_px = _common_shift_px(last, detections)
        before, self._places = self._places, {}
        ids = detections.ids.copy()
        for robot in sorted(repeated | before.keys()):
            rows = np.flatnonzero(detections.ids == robot)
            places = _Places.unknown(detections[rows])
            if robot in before:
                moved_px = before[robot].points_px + shift_px
                places = replace(before[robot], points_px=moved_px).follow(detections[rows])
            places = places.judged()
            if places.is_copy.any() or places.seen_s.size > 1:
                self._places[robot] = places
            ids[rows[places.is_copy[: rows.size]]] = COPY_ID + robot
        return replace(detections, ids=ids)[np.argsort(ids, kind="stable")] if self._places else detections


def _common_shift_px(before: Detections, now: Detections) -> complex:
    """Return the motion of the image between two images: the median over the markers in both."""
    before, now = before.unambiguous(), now.unambiguous()
    _, row, row_before = np.intersect1d(now.ids, before.ids, assume_unique=True, return_indices=True)
    if not row.size:
        return 0j
    return complex(*np.median(now.centers_px[row] - before.centers_px[row_before], axis=0))
