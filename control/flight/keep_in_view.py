"""Flight law of the tree protocol: keep all controlled robots in view, with a margin."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.control.flight.image_memory import ImageMemory
from skyherd.control.flight.radio_links import HOLD_SHARE, kept_links, within_links
from skyherd.control.formation.template import Template
from skyherd.control.policy import FlightLaw, FlightTask
from skyherd.geometry import Array, IntArray, to_complex, to_points
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

VAIN_CLIMB_M = 1.0
"""Commanded climb without effect after which a unit is at its ceiling, m. Chosen: it changes the scale by
`VAIN_CHANGE` or more below a height of 100 m."""

VAIN_CLIMB_S = 2.0
"""Minimum time of such a climb, s. Chosen: longer than an autopilot takes to reach its climb rate."""

VAIN_CHANGE = 0.01
"""Decrease of the markers' sides below which a climb has no effect, as a share. Chosen: five times the error
of the median side of some markers of 20 px."""

MAX_PERIODS = 1.5
"""Time after an image for which a climb is taken to last, in shortest times between two images. Chosen: a
unit may have held its position in a longer gap."""

CEILING_LIFE_S = 60.0
"""Time for which a unit remembers its ceiling, s. Chosen: ten times the climb that tests it again."""


class LearnedCeiling:
    """Scale of a unit's image at its ceiling, learned from a commanded climb that changes no scale.

    A unit knows neither its height nor the hall's. Its markers' sides shrink as it climbs or zooms out. If
    they do not, it is as high as it can be. The ceiling is tested again after `CEILING_LIFE_S`: it may be
    higher elsewhere.

    Attributes:
        side_px: smallest median side of the markers at the ceiling; 0 if no ceiling is known.
    """

    def __init__(self) -> None:
        self.side_px = 0.0
        self._learned_s = 0.0
        self._climb_mps = self._climbed_m = 0.0
        self._start: Detections | None = None
        self._last_s, self._period_s = -np.inf, np.inf

    def look(self, seen: Detections, side_px: float) -> None:
        """Update the ceiling with an image and the median side of its markers."""
        passed_s, self._last_s = seen.time_s - self._last_s, seen.time_s
        if passed_s > 0:
            # A unit that held its position in between did not call the law. It has not climbed all the time.
            self._period_s = min(self._period_s, passed_s)
            self._climbed_m += self._climb_mps * min(passed_s, MAX_PERIODS * self._period_s, VAIN_CLIMB_S / 2)
        if self.side_px:
            self.side_px = min(self.side_px, side_px)
            if seen.time_s - self._learned_s >= CEILING_LIFE_S:
                self.side_px, self._start = 0.0, None
            return
        change = np.nan if self._start is None else _scale_change(self._start, seen)
        if self._start is None or not abs(change) < VAIN_CHANGE:
            self._start, self._climbed_m = seen, 0.0
        elif self._climbed_m >= VAIN_CLIMB_M and seen.time_s - self._start.time_s >= VAIN_CLIMB_S:
            self.side_px, self._learned_s = side_px, seen.time_s

    def command(self, climb_mps: float) -> None:
        """Record the climb commanded until the next image. Without a climb, the test begins again."""
        self._climb_mps = climb_mps
        if climb_mps <= 0:
            self._start = None


def _scale_change(before: Detections, now: Detections) -> float:
    """Return the relative change of the markers' sides between two images; NaN without common markers."""
    _, one, two = np.intersect1d(before.ids, now.ids, return_indices=True)
    return float(np.median(now.sides_px[two] / before.sides_px[one])) - 1 if one.size else np.nan


@dataclass
class KeepInView(FlightLaw):
    """Flight law that keeps the whole control set within `desired_radius` of the image centre.

    The lateral velocity leads to the middle of the set: `v = lateral_gain c`, with c the centre of its
    bounding box in the image. The unit climbs and zooms out in proportion to the excess of the farthest robot
    over `desired_radius`. It descends and zooms in if the farthest robot is nearer. With `border_sides`, the
    distance to the border counts likewise, so that bodies near the farthest robot are in view.

    - Unseen robots count at their remembered positions (control/flight/image_memory.py). A unit that takes
      over robots outside its view therefore flies to them. While one of them has no known position, it
      climbs.
    - Sought robots count as well. They move the unit laterally only while the set itself is within the
      radius: below a ceiling it may be unable to keep both in view.
    - If the unit cannot climb, or if markers would become too small for the required view, it patrols. It
      flies to the robot unseen for longest, until it has seen that robot for `patrol_s`, then to the next. It
      must see enough others to know its position.
    - A unit without robots keeps all visible robots in view and climbs to see more.
    - Units that come too close move apart, measured between image centres in marker sides.
    - Of several units with the same set, only the first moves.
    - With a limited radio range, a unit stays within it of the units that connect it to the others
      (control/flight/radio_links.py). This comes before its view.

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
        border_sides: minimum distance of the set from the border of the image, in marker sides. A body that
            approaches a robot is visible if this exceeds the distance at which the two touch, plus the
            margin, plus half the diagonal of the body's card.
        patrol_s: observation time of each robot on patrol. Chosen: two dwell times, in which a robot can be
            adopted.
        radio_range_sides: radio range on the ground, in marker sides; infinite without a limit.
    """

    template: Template
    desired_radius: float = 0.7
    lateral_gain_mps: float = 1.0
    climb_gain_mps: float = 1.0
    zoom_gain_ps: float = 0.3
    dead_band: float = 0.02
    separation_sides: float = 6.0
    min_side_px: float = 12.0
    border_sides: float = 0.0
    patrol_s: float = 4.0
    radio_range_sides: float = np.inf
    memory: ImageMemory = field(init=False)
    ceiling: LearnedCeiling = field(default_factory=LearnedCeiling, init=False)
    _side_px: float = field(default=np.inf, init=False)
    _target: int = field(default=NO_ID, init=False)
    _target_seen_s: float = field(default=0.0, init=False)
    _last_s: float = field(default=-np.inf, init=False)

    def __post_init__(self) -> None:
        gains = ("lateral_gain_mps", "climb_gain_mps", "zoom_gain_ps", "dead_band")
        lengths = ("separation_sides", "min_side_px", "border_sides")
        check_kind("KeepInView.template", self.template, Template, "a Template")
        check_numbers(self, positive=("desired_radius",), not_negative=(*gains, *lengths))
        check_numbers(self, positive=("radio_range_sides",), endless=("radio_range_sides",))
        self.memory = ImageMemory(self.template)

    def command(self, seen: Detections, task: FlightTask, reports: Sequence[UnitReport]) -> FlightCommand:
        """Return velocity and zoom that keep the robots of the task, seen or remembered, in view."""
        self.memory.update(seen, reports)
        if len(seen):
            self._side_px = float(np.sort(seen.sides_px)[len(seen) // 2])
            self.ceiling.look(seen, self._side_px)
        command = self._follow(seen, task, reports)
        if task.widen:
            more = min(self.desired_radius / 2, self._room)
            command = replace(
                command,
                climb_mps=max(command.climb_mps, self.climb_gain_mps * more),
                zoom_rate_ps=min(command.zoom_rate_ps, -self.zoom_gain_ps * more),
            )
        self.ceiling.command(command.climb_mps)
        lateral_mps = self._in_radio_range(seen, command.lateral_mps)
        return replace(command, lateral_mps=lateral_mps + task.drift_mps)

    def _in_radio_range(self, seen: Detections, lateral_mps: Array) -> Array:
        """Return the lateral velocity (2,), m/s, changed to keep the unit's radio links."""
        if not (self.memory.centers_px and np.isfinite(self.radio_range_sides + self._side_px)):
            return lateral_mps
        centers = centred(to_points(list(self.memory.centers_px.values())), seen.image_size_px)
        sides = self._side_px / (seen.image_size_px.min() / 2)
        hold = HOLD_SHARE * self.radio_range_sides * sides
        offsets = centers[kept_links(to_complex(centers))]
        return within_links(lateral_mps, offsets, hold, self.lateral_gain_mps)

    def _follow(self, seen: Detections, task: FlightTask, reports: Sequence[UnitReport]) -> FlightCommand:
        controlled, own_set = task.controlled_ids, frozenset(task.controlled_ids.tolist())
        if own_set and any(r.controlled == own_set for r in reports if r.unit_id < seen.unit_id):
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
        is_kept = self._excess(own, seen) <= self.dead_band
        excess = self._excess(points, seen)
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

    def _excess(self, points: Array, seen: Detections) -> float:
        """Return the excess of the farthest of points (M, 2) over the permitted distance, half images."""
        farthest = float(np.linalg.norm(points, axis=1).max())
        excess = farthest - self.desired_radius
        if not (self.border_sides and np.isfinite(self._side_px)):
            return excess
        side = self._side_px / float(seen.image_size_px.min() / 2)
        return max(excess, farthest + self.border_sides * side - 1)

    @property
    def _room(self) -> float:
        """Possible climb, as a share of the height, before the ceiling or before markers are too small."""
        smallest_px = max(self.min_side_px, self.ceiling.side_px)
        return self._side_px / smallest_px - 1 if smallest_px else np.inf

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
