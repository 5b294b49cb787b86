"""Flight that serves the topology: keep in view, with margin, all robots that the unit has a duty to."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.control.flight.image_memory import ImageMemory
from skyherd.control.flight.laws import Duty, Flight
from skyherd.control.formation.template import Template
from skyherd.geometry import Array, IntArray, to_points
from skyherd.messages import Detections, FlightCommand, UnitReport, centred


@dataclass
class KeepInView(Flight):
    """Fly so that the whole control set lies within `desired_radius` of the image centre.

    Towards the middle of the set, `v = gain c`, with c the centre of its bounding box in the image; up, and
    the zoom out, in proportion to how much farther than `desired_radius` the farthest robot is; down and in
    if it is nearer. Robots that the unit does not see count where memory has them
    (control/flight/image_memory.py), so that a unit that takes over robots outside its view flies to where
    they are; while one of them has no place yet, it climbs. Robots that it seeks count as well; they draw it
    aside only while the set itself is within the radius, since below a ceiling it may be unable to have both.
    A unit without robots keeps in view all that it sees, and climbs to see more. Units that come too near to
    one another, measured between image centres in marker sides, part. Of several units with the same set, all
    but the first stay.

    Attributes:
        template: names the team.
        desired_radius: image distance of the farthest robot, in halves of the image's shorter side.
        lateral_gain_mps: speed for a centre half an image off.
        climb_gain_mps: climb for a farthest robot half an image too far out.
        zoom_gain_ps: relative change of zoom for the same, 1/s.
        dead_band: errors of radius below this change nothing.
        separation_sides: least distance between the image centres of two units, in marker sides.
        least_side_px: it neither climbs nor zooms out beyond where markers have this side in the median, and
            sinks or zooms in where they have less: a marker that is too small is not seen at all.
    """

    template: Template
    desired_radius: float = 0.75
    lateral_gain_mps: float = 1.0
    climb_gain_mps: float = 1.0
    zoom_gain_ps: float = 0.3
    dead_band: float = 0.02
    separation_sides: float = 6.0
    least_side_px: float = 12.0
    memory: ImageMemory = field(init=False)
    _side_px: float = field(default=np.inf, init=False)

    def __post_init__(self) -> None:
        self.memory = ImageMemory(self.template)

    def command(self, seen: Detections, duty: Duty, reports: Sequence[UnitReport]) -> FlightCommand:
        """Velocity and zoom for the robots in duty, seen or remembered."""
        self.memory.update(seen, reports)
        if len(seen):
            self._side_px = float(np.sort(seen.sides_px)[len(seen) // 2])
        controlled, robots = duty.controlled, frozenset(duty.controlled.tolist())
        if robots and any(r.controlled == robots for r in reports if r.unit_id < seen.unit_id):
            return FlightCommand(seen.unit_id, self._part(seen), 0.0, 0.0)
        own = self.memory.centred(controlled if controlled.size else seen.ids, seen.image_size_px)
        if not len(own):
            return FlightCommand(
                seen.unit_id, self._part(seen), self.climb_gain_mps * min(0.5, self._room), 0.0
            )
        points = np.concatenate([own, self.memory.centred(duty.sought, seen.image_size_px)])
        is_kept = _farthest(own) <= self.desired_radius + self.dead_band
        excess = _farthest(points) - self.desired_radius
        if not controlled.size or not self.memory.known[self.memory.rows(controlled)].all():
            excess = max(excess, self.desired_radius / 2)
        excess -= float(np.clip(excess, -self.dead_band, self.dead_band))
        excess = min(excess, self._room)
        lateral = self.lateral_gain_mps * _middle(points if is_kept else own) + self._part(seen)
        return FlightCommand(
            seen.unit_id, lateral, self.climb_gain_mps * excess, 0.0, -self.zoom_gain_ps * excess
        )

    def search(self, seen: Detections, controlled: IntArray, reports: Sequence[UnitReport]) -> FlightCommand:
        """Keep all that is seen in view, and climb and zoom out all the while."""
        command = super().search(seen, controlled, reports)
        more = min(self.desired_radius / 2, self._room)
        return replace(
            command,
            climb_mps=max(command.climb_mps, self.climb_gain_mps * more),
            zoom_rate_ps=min(command.zoom_rate_ps, -self.zoom_gain_ps * more),
        )

    @property
    def _room(self) -> float:
        """How much higher it may go, as a share of its height, before markers are too small."""
        return self._side_px / self.least_side_px - 1 if self.least_side_px else np.inf

    def _part(self, seen: Detections) -> Array:
        """Velocity (2,) away from units that are too near."""
        if not (len(seen) and self.memory.centers_px and self.separation_sides):
            return np.zeros(2)
        centers = to_points(list(self.memory.centers_px.values()))
        least = self.separation_sides * self._side_px / (seen.image_size_px.min() / 2)
        offsets = centred(centers, seen.image_size_px)
        distances = np.linalg.norm(offsets, axis=1)
        pushes = np.maximum(1 - distances / least, 0.0) / np.maximum(distances, 1e-6)
        return np.asarray(-self.lateral_gain_mps * (pushes @ offsets))


def _middle(points: Array) -> Array:
    """Centre (2,) of the bounding box of points (M, 2)."""
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)


def _farthest(points: Array) -> float:
    """Largest distance of points (M, 2) from the image centre."""
    return float(np.linalg.norm(points, axis=1).max())
