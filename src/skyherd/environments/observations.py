"""Observations of agents: vectors in marker sides, detections, or images.

Values are clipped to the bounds of their spaces. An agent without knowledge observes zeros.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from gymnasium.spaces import Box, Dict, Space

from skyherd.control import MarkerGains
from skyherd.environments.knowledge import Cast, Knowledge, View
from skyherd.errors import InputError
from skyherd.geometry import Array, Image, IntArray
from skyherd.messages import Detections, among, find_rows

MAX_SIDES = 100.0
"""Bound of lengths, marker sides. Chosen: beyond the shapes of the built-in scenarios."""

MAX_IMAGE_UNITS = 4.0
"""Bound of image coordinates, halves of the image's shorter side. Chosen: images of 4:1."""

MAX_AGE_S = 10.0
"""Bound of the age of an image, s. Chosen: beyond the time after which units and robots forget."""

UNIT_LAW = MarkerGains(k=1.0, k_omega=1.0, b_th=0.0, side_m=1.0)
"""Law by which goals of several units are added, in marker sides."""


class Observer(Protocol):
    """Interface of a kind of observation.

    Attributes:
        spaces: space of each agent.
    """

    spaces: Sequence[Space[Any]]

    def observe(self, known: Knowledge) -> Sequence[Any]:
        """Return the observation of each agent."""
        ...


def _boxes(low: Array, high: Array, count: int) -> list[Box]:
    """Return spaces for `count` agents; each has a random generator of its own."""
    return [Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32) for _ in range(count)]


class RobotVectors(Observer):
    """Values that each robot knows from its messages and its own commands.

    The order is: goal forward and left, marker sides; 1 with a goal, else 0; last v and ω as shares of their
    limits; then the nearest bodies. A body has its gap, marker sides, and the direction to it, a unit vector
    forward and left. A missing body has the gap `MAX_SIDES` and a zero vector.

    Args:
        cast: robots and bodies.
        bodies: number of nearest bodies.
    """

    def __init__(self, cast: Cast, bodies: int) -> None:
        self.bodies = bodies if cast.has_bodies else 0
        goal, body = [MAX_SIDES, MAX_SIDES, 1.0, 1.0, 1.0], [MAX_SIDES, 1.0, 1.0] * self.bodies
        high = np.array([*goal, *body])
        low = -high
        low[2] = 0.0
        self.spaces = _boxes(low, high, cast.robot_ids.size)

    def observe(self, known: Knowledge) -> list[Array]:
        """Return the vectors of all robots, each (5 + 3 bodies,)."""
        inboxes = known.team.present_inboxes(known.time_s)
        rho = UNIT_LAW.follow(inboxes, known.time_s)
        fresh = inboxes.fresh(known.time_s).any(axis=0)
        goals = np.column_stack([rho.real, rho.imag, fresh, known.rates])
        rows = np.concatenate([goals, self._near_bodies(known)], axis=1)
        return [_clipped(row, space) for row, space in zip(rows, self.spaces, strict=True)]

    def _near_bodies(self, known: Knowledge) -> Array:
        """Return the values (N, 3 bodies) of the bodies near each robot, the nearest first."""
        memory, robots = known.team.neighbors, known.rates.shape[0]
        if memory is None or not self.bodies:
            return np.zeros((robots, 0))
        pair = memory.fresh(known.time_s + known.team.lead_s(known.time_s))
        gaps = np.full((robots, memory.other_ids.size), MAX_SIDES)
        directions = np.zeros(gaps.shape, dtype=complex)
        gaps[pair] = memory.distances_sides[pair] - memory.reaches_sides[pair]
        directions[pair] = np.exp(1j * memory.bearings_rad(pair, known.time_s))
        nearest = np.argsort(gaps, axis=1, kind="stable")[:, : self.bodies]
        near, towards = (np.take_along_axis(of, nearest, axis=1) for of in (gaps, directions))
        values = np.tile([MAX_SIDES, 0.0, 0.0], (robots, self.bodies, 1))
        values[:, : nearest.shape[1]] = np.stack([near, towards.real, towards.imag], axis=2)
        return values.reshape(robots, -1)


class UnitVectors(Observer):
    """Markers in each unit's image, relative to the image centre, a row (6,) for each marker by id.

    A row has: 1 if the marker is seen, else zeros; u and v from the image centre, in the mean marker side of
    the image; that side in halves of the image's shorter side; 1 if the unit controls the robot; age of the
    image, s. Positions are rectified, as the unit's controller uses them.

    Args:
        cast: markers and units.
    """

    def __init__(self, cast: Cast) -> None:
        self.marker_ids = cast.marker_ids
        high = np.tile(
            [1.0, MAX_SIDES, MAX_SIDES, MAX_IMAGE_UNITS, 1.0, MAX_AGE_S], (cast.marker_ids.size, 1)
        )
        low = high * [0.0, -1.0, -1.0, 0.0, 0.0, 0.0]
        self.spaces = _boxes(low, high, len(cast.image_sizes_px))

    def observe(self, known: Knowledge) -> list[Array]:
        """Return the rows of all units, each (M, 6)."""
        return [
            _clipped(self._rows(known.views.get(unit), known.time_s), space)
            for unit, space in enumerate(self.spaces)
        ]

    def _rows(self, view: View | None, time_s: float) -> Array:
        rows = np.zeros((self.marker_ids.size, 6))
        if view is None:
            return rows
        at, seen = _by_id(self.marker_ids, view.accepted)
        if not len(seen):
            return rows
        half_px = float(seen.image_size_px.min()) / 2
        side = float(seen.sides_px.mean()) / half_px
        rows[at, 0] = 1.0
        rows[at, 1:3] = seen.centred / side
        rows[at, 3] = side
        rows[at, 4] = among(seen.ids, view.controlled_ids)
        rows[at, 5] = time_s - view.detections.time_s
        return rows


def _by_id(marker_ids: IntArray, detections: Detections) -> tuple[IntArray, Detections]:
    """Return the rows of detections in `marker_ids` and these detections; no other ids, no repeated ones."""
    order = np.argsort(marker_ids)
    seen = detections.unambiguous()
    rows, known = find_rows(marker_ids[order], seen.ids)
    return order[rows[known]], seen[known]


def _clipped(values: Array, space: Box) -> Array:
    return np.clip(values.astype(np.float32), space.low, space.high)


class _DetectionRows:
    """Detections of an image, a row (7,) for each marker by id.

    A row has: 1 if the marker is detected, else zeros; u and v from the image centre, in halves of the
    image's shorter side; cosine and sine of the heading in the image; marker side in the same unit; age of
    the image, s.
    """

    HIGH = (1.0, MAX_IMAGE_UNITS, MAX_IMAGE_UNITS, 1.0, 1.0, MAX_IMAGE_UNITS, MAX_AGE_S)
    LOW = (0.0, -MAX_IMAGE_UNITS, -MAX_IMAGE_UNITS, -1.0, -1.0, 0.0, 0.0)

    def __init__(self, marker_ids: IntArray) -> None:
        self.marker_ids = marker_ids

    def rows(self, view: View | None, time_s: float) -> Array:
        """Return the rows (M, 7) of a unit's last image."""
        rows = np.zeros((self.marker_ids.size, len(self.HIGH)))
        if view is None:
            return rows
        at, seen = _by_id(self.marker_ids, view.detections)
        rows[at, 0] = 1.0
        rows[at, 1:3] = seen.centred
        rows[at, 3], rows[at, 4] = np.cos(seen.headings_rad), np.sin(seen.headings_rad)
        rows[at, 5] = 2 * seen.sides_px / seen.image_size_px.min()
        rows[at, 6] = time_s - seen.time_s
        return rows


class UnitDetections(Observer):
    """Detections in each unit's own image, as `_DetectionRows` describes them.

    Args:
        cast: markers and units.
    """

    def __init__(self, cast: Cast) -> None:
        self._table = _DetectionRows(cast.marker_ids)
        low, high = (
            np.tile(bound, (cast.marker_ids.size, 1)) for bound in (self._table.LOW, self._table.HIGH)
        )
        self.spaces = _boxes(low, high, len(cast.image_sizes_px))

    def observe(self, known: Knowledge) -> list[Array]:
        """Return the rows of all units, each (M, 7)."""
        return [
            _clipped(self._table.rows(known.views.get(unit), known.time_s), space)
            for unit, space in enumerate(self.spaces)
        ]


class RobotDetections(Observer):
    """Detections in the images of all units; the robot's own marker is the first row.

    Args:
        cast: markers and units.
    """

    def __init__(self, cast: Cast) -> None:
        self._table, self._units = _DetectionRows(cast.marker_ids), len(cast.image_sizes_px)
        shape = self._units, cast.marker_ids.size, 1
        low, high = (np.tile(bound, shape) for bound in (self._table.LOW, self._table.HIGH))
        self.spaces = _boxes(low, high, cast.robot_ids.size)
        markers = np.arange(cast.marker_ids.size)
        self._orders = [np.append(own, np.delete(markers, own)) for own in range(cast.robot_ids.size)]

    def observe(self, known: Knowledge) -> list[Array]:
        """Return the rows for all robots, each (U, M, 7)."""
        views = [known.views.get(unit) for unit in range(self._units)]
        rows = np.stack([self._table.rows(view, known.time_s) for view in views])
        rows = _clipped(rows, self.spaces[0])
        return [rows[:, order] for order in self._orders]


class _Pictures:
    """Last images of the units, (height, width, 1); black before the first one.

    Args:
        cast: units.
        size_px: width and height to which images are resized; None for those of the cameras.
    """

    def __init__(self, cast: Cast, size_px: tuple[int, int] | None) -> None:
        self.sizes_px = [size_px or own for own in cast.image_sizes_px]

    def space(self, unit: int) -> Box:
        """Return a new space of a unit's image."""
        width, height = self.sizes_px[unit]
        return Box(0, 255, (height, width, 1), np.uint8)

    def take(self, known: Knowledge, unit: int) -> Image:
        """Return the last image of a unit."""
        view, (width, height) = known.views.get(unit), self.sizes_px[unit]
        if view is None or view.image is None:
            return np.zeros((height, width, 1), np.uint8)
        image = view.image
        if image.shape != (height, width):
            image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
        return image[..., None]


class UnitImages(Observer):
    """Each unit's own last image.

    Args:
        cast: units.
        size_px: as for `_Pictures`.
    """

    def __init__(self, cast: Cast, size_px: tuple[int, int] | None) -> None:
        self._pictures = _Pictures(cast, size_px)
        self.spaces = [self._pictures.space(unit) for unit in range(len(cast.image_sizes_px))]

    def observe(self, known: Knowledge) -> list[Image]:
        """Return the images of all units."""
        return [self._pictures.take(known, unit) for unit in range(len(self.spaces))]


class RobotImages(Observer):
    """Last images of all units for each robot, by the unit's name.

    Args:
        cast: robots and units.
        size_px: as for `_Pictures`.
    """

    def __init__(self, cast: Cast, size_px: tuple[int, int] | None) -> None:
        self._pictures, self._units = _Pictures(cast, size_px), range(len(cast.image_sizes_px))
        self.spaces = [
            Dict({f"unit_{unit}": self._pictures.space(unit) for unit in self._units}) for _ in cast.robot_ids
        ]

    def observe(self, known: Knowledge) -> list[dict[str, Image]]:
        """Return the images for all robots, which share the arrays."""
        images = {f"unit_{unit}": self._pictures.take(known, unit) for unit in self._units}
        return [dict(images) for _ in self.spaces]


@dataclass(frozen=True)
class ObservationOptions:
    """Options of observations.

    Attributes:
        kind: `vectors`, `detections` or `images`.
        bodies: number of bodies in the vector of a robot.
        image_size_px: width and height of images; None for those of the cameras.
    """

    kind: str
    bodies: int
    image_size_px: tuple[int, int] | None


OBSERVERS: dict[tuple[str, str], Callable[[Cast, ObservationOptions], Observer]] = {
    ("vectors", "wheels"): lambda cast, options: RobotVectors(cast, options.bodies),
    ("vectors", "flight"): lambda cast, options: UnitVectors(cast),
    ("detections", "wheels"): lambda cast, options: RobotDetections(cast),
    ("detections", "flight"): lambda cast, options: UnitDetections(cast),
    ("images", "wheels"): lambda cast, options: RobotImages(cast, options.image_size_px),
    ("images", "flight"): lambda cast, options: UnitImages(cast, options.image_size_px),
}
"""Observers by the kinds of observations and actions."""


def make_observer(cast: Cast, options: ObservationOptions, actions: str, perception: str) -> Observer:
    """Make the observer of a kind of observations for the agents of a kind of actions.

    Args:
        cast: robots and units.
        options: kind and details of the observations.
        actions: `wheels` or `flight`.
        perception: the scenario's perception.

    Raises:
        InputError: images are asked for, and the perception makes none.
    """
    if options.kind == "images" and perception != "rendered":
        allowed = "perception = rendered, or observations vectors or detections"
        raise InputError("FormationEnv: observations images", f"none with perception {perception}", allowed)
    return OBSERVERS[options.kind, actions](cast, options)
