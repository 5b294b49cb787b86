"""Flight law of the tree protocol: keep all controlled robots in view, with a margin."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.control.flight.image_memory import ImageMemory
from skyherd.control.formation.template import Template
from skyherd.control.policy import FlightLaw, FlightTask
from skyherd.geometry import Array, IntArray, to_points
from skyherd.messages import NO_ID, Detections, FlightCommand, UnitReport, centred
from skyherd.messages.checks import check_kind, check_numbers

MIN_DISTANCE = 1e-6
"""Minimum divisor for distances between image centres, half images. Chosen: it avoids 0 / 0; units at one
place are then not pushed in any direction."""

ANCHORS = 3
"""Minimum number of visible robots on patrol. Chosen: two determine the similarity between two images, and
one may be missed."""

CEILING = 0.1
"""A unit that could climb by less than this share of its height is at its ceiling. Chosen: it approaches the
ceiling in ever smaller steps, and would gain at most 10 % of view."""


@dataclass
class KeepInView(FlightLaw):
    """Flight law that keeps the whole control set within `desired_radius` of the image centre.

    The lateral velocity leads to the middle of the set: `v = lateral_gain c`, with c the centre of its
    bounding box in the image. The unit climbs and zooms out in proportion to the excess of the farthest robot
    over `desired_radius`. It descends and zooms in if the farthest robot is nearer.

    - Unseen robots count at their remembered positions (control/flight/image_memory.py). A unit that takes
      over robots outside its view therefore flies to them. While one of them has no known position, it
      climbs.
    - Sought robots count as well. They move the unit laterally only while the set itself is within the
      radius: below a ceiling it may be unable to keep both in view.
    - If markers would become too small for the required view, the unit patrols. It flies to the robot unseen
      for longest, until it has seen that robot for `patrol_s`, then to the next. It must see enough others to
      know its position.
    - A unit without robots keeps all visible robots in view and climbs to see more.
    - Units that come too close move apart, measured between image centres in marker sides.
    - Of several units with the same set, only the first moves.

    Attributes:
        template: template with the ids of the team.
        desired_radius: image distance of the farthest robot, in halves of the image's shorter side. Chosen:
            below the safety radius, so that a robot may move during a dwell time before it leaves the set.
        lateral_gain_mps: speed per half image of offset of the centre.
        climb_gain_mps: climb per half image of excess of the farthest robot.
        zoom_gain_ps: relative change of zoom for the same, 1/s.
        dead_band: radius error without effect, so that noise does not move the unit.
        separation_sides: minimum distance between the image centres of two units, in marker sides.
        min_side_px: minimum median side of the markers. The unit neither climbs nor zooms out below it, and
            descends or zooms in if it is smaller: a marker that is too small is not detected.
        patrol_s: observation time of each robot on patrol. Chosen: two dwell times, in which a robot can be
            adopted.
    """

    template: Template
    desired_radius: float = 0.7
    lateral_gain_mps: float = 1.0
    climb_gain_mps: float = 1.0
    zoom_gain_ps: float = 0.3
    dead_band: float = 0.02
    separation_sides: float = 6.0
    min_side_px: float = 12.0
    patrol_s: float = 4.0
    memory: ImageMemory = field(init=False)
    _side_px: float = field(default=np.inf, init=False)
    _target: int = field(default=NO_ID, init=False)
    _target_seen_s: float = field(default=0.0, init=False)
    _last_s: float = field(default=-np.inf, init=False)

    def __post_init__(self) -> None:
        gains = ("lateral_gain_mps", "climb_gain_mps", "zoom_gain_ps", "dead_band")
        lengths = ("separation_sides", "min_side_px")
        check_kind("KeepInView.template", self.template, Template, "a Template")
        check_numbers(self, positive=("desired_radius",), not_negative=(*gains, *lengths))
        self.memory = ImageMemory(self.template)

    def command(self, seen: Detections, task: FlightTask, reports: Sequence[UnitReport]) -> FlightCommand:
        """Return velocity and zoom that keep the robots of the task, seen or remembered, in view."""
        self.memory.update(seen, reports)
        if len(seen):
            self._side_px = float(np.sort(seen.sides_px)[len(seen) // 2])
        command = self._follow(seen, task, reports)
        if not task.widen:
            return command
        more = min(self.desired_radius / 2, self._room)
        return replace(
            command,
            climb_mps=max(command.climb_mps, self.climb_gain_mps * more),
            zoom_rate_ps=min(command.zoom_rate_ps, -self.zoom_gain_ps * more),
        )

    def _follow(self, seen: Detections, task: FlightTask, reports: Sequence[UnitReport]) -> FlightCommand:
        controlled, robots = task.controlled_ids, frozenset(task.controlled_ids.tolist())
        if robots and any(r.controlled == robots for r in reports if r.unit_id < seen.unit_id):
            return FlightCommand(
                seen.unit_id, self._away_from_others(seen), climb_mps=0.0, yaw_rate_radps=0.0
            )
        own = self.memory.centred(controlled if controlled.size else seen.ids, seen.image_size_px)
        if not len(own):
            return FlightCommand(
                seen.unit_id,
                self._away_from_others(seen),
                climb_mps=self.climb_gain_mps * min(0.5, self._room),
                yaw_rate_radps=0.0,
            )
        points = np.concatenate([own, self.memory.centred(task.sought_ids, seen.image_size_px)])
        is_kept = _farthest(own) <= self.desired_radius + self.dead_band
        excess = _farthest(points) - self.desired_radius
        if not controlled.size or not self.memory.known[self.memory.rows(controlled)].all():
            excess = max(excess, self.desired_radius / 2)
        excess -= min(max(excess, -self.dead_band), self.dead_band)
        is_at_ceiling = excess > self._room and self._room < CEILING
        wanted = self._patrol(seen, np.union1d(controlled, task.sought_ids)) if is_at_ceiling else None
        excess = min(excess, self._room)
        middle = _middle(points if is_kept else own) if wanted is None else wanted
        lateral = self.lateral_gain_mps * middle + self._away_from_others(seen)
        return FlightCommand(
            seen.unit_id,
            lateral,
            climb_mps=self.climb_gain_mps * excess,
            yaw_rate_radps=0.0,
            zoom_rate_ps=-self.zoom_gain_ps * excess,
        )

    def _patrol(self, seen: Detections, robots: IntArray) -> Array | None:
        """Return the point (2,), half images, to fly to while `robots` do not fit into the view, or None."""
        known = robots[self.memory.known[self.memory.rows(robots)]]
        if not known.size or len(seen) < ANCHORS:
            self._target = NO_ID
            return None
        passed_s, self._last_s = seen.time_s - self._last_s, seen.time_s
        in_view = self._target in seen.ids
        self._target_seen_s += passed_s if in_view and np.isfinite(passed_s) else 0.0
        if self._target not in known or self._target_seen_s >= self.patrol_s:
            ages = self.memory.seen_s[self.memory.rows(known)]
            self._target, self._target_seen_s = int(known[np.argmin(ages)]), 0.0
        return np.asarray(self.memory.centred(np.array([self._target]), seen.image_size_px)[0])

    @property
    def _room(self) -> float:
        """Possible climb, as a share of the height, before markers are too small."""
        return self._side_px / self.min_side_px - 1 if self.min_side_px else np.inf

    def _away_from_others(self, seen: Detections) -> Array:
        """Return a velocity (2,) away from units that are too close."""
        if not (len(seen) and self.memory.centers_px and self.separation_sides):
            return np.zeros(2)
        centers = to_points(list(self.memory.centers_px.values()))
        least = self.separation_sides * self._side_px / (seen.image_size_px.min() / 2)
        offsets = centred(centers, seen.image_size_px)
        distances = np.linalg.norm(offsets, axis=1)
        pushes = np.maximum(1 - distances / least, 0.0) / np.maximum(distances, MIN_DISTANCE)
        return np.asarray(-self.lateral_gain_mps * (pushes @ offsets))


def _middle(points: Array) -> Array:
    """Return the centre (2,) of the bounding box of points (M, 2)."""
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)


def _farthest(points: Array) -> float:
    """Return the largest distance of points (M, 2) from the image centre."""
    return float(np.linalg.norm(points, axis=1).max())
