"""Consistency of a robot's motion in the images of one unit with its own commands.

Exchanged markers, exchanged drivers, a marker that is mounted turned, and reversed wheels have in common that
the marker moves otherwise than the wheels were told. The robot then drives away from its goal instead of
towards it. It can tell, because it knows its commands, and units report where they see its marker.

Motion is compared in steps of `STEP_S`. Each step has a seen and a commanded motion: a displacement in the
robot's frame at the start of the step, in marker sides, and a turn. One side weighs as much as one radian.
With the seen motions o and the commanded motions c of the last steps as vectors

    |o| ≥ RESPONSE |c|,   |c| ≥ RESPONSE |o|,   o · c ≥ ALIKE |o| |c|

hold for a robot that follows its commands. It may drive up to five times faster or slower than told, and its
marker may be mounted turned by less than 60°. The motion may have one of the lags `LAGS_S` behind the
commands. The displacement does not count for a unit that flies, since its own motion displaces the marker
too.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from skyherd.control.robots.latency_compensation import LatencyCompensation
from skyherd.geometry import Array, ComplexArray
from skyherd.messages import Sighting

STEP_S = 1.0
"""Shortest duration of a step, s. Chosen: a few times the unknown latency of a drive."""

STEPS = 5
"""Number of the last steps that are compared. Chosen: a robot drives a metre meanwhile, at the
default limits."""

MIN_STEPS = 3
"""Smallest number of steps for a judgement. Chosen: the first second, in which a drive gathers speed, does
not decide alone. Measured: without the step in which both motions differ most, exchanged robots take three
times as long to find."""

LAGS_S = (0.0, 0.3, 0.6)
"""Lags of a robot's motion behind its commands, s, beyond the known latency. Chosen: up to the default
time for which a robot follows a goal."""

MIN_MOTION = 2.0
"""Smallest norm of the motions seen or commanded for a judgement, sides or rad. Chosen: five steps at 0.9
sides/s. A robot that turns to and fro at its goal has less. At 1 a noisy one is accused once in ten
minutes."""

RESPONSE = 0.2
"""Smallest ratio of the lesser of both motions to the greater one. Chosen: as for a unit's check of its
camera (`skyherd.control.image_delay.RESPONSIVE`)."""

ALIKE = 0.5
"""Smallest cosine between both motions. Chosen: half-way between 0 of unrelated and 1 of equal motions."""

FULL_PACE = 0.5
"""Smallest root mean square of the commands, as a share of the limits, for the fault that a robot stands
still. Chosen: above the dead zones of wheels, in which a robot near its goal stands still."""

MAX_JUMP_SIDES = 1.0
"""Displacement between two images, beyond the commanded one, after which a new step begins, marker sides.
Chosen: a misread marker and a robot in someone's hand jump. At 5 images/s a wrong drive jumps above
5 sides/s."""

MAX_GAP_S = 1.0
"""Longest time between two images of a step, s. Chosen: a robot has forgotten its goals by then."""

STANDS = "its marker stands still, although it was told to drive"
"""Fault: far less motion than commanded."""

STRAYS = (
    "its marker moves otherwise than its wheels were told: exchanged, turned or reversed, or are images late?"
)
"""Fault: unrelated, reversed, or far more motion than commanded."""


@dataclass(frozen=True)
class SeenPose:
    """A robot's marker in an image, and the poses that its commands led to.

    Attributes:
        time_s: time of the image on the robot's clock.
        center_px: its centre, `u + iv`.
        heading_rad: its heading in the image, from +u to +v.
        side_px: its side.
        commanded_sides: (L,) places `x + iy` of the marker by dead reckoning, `LAGS_S` before the image, in
            any fixed frame, marker sides.
        commanded_rad: (L,) headings by dead reckoning, counter-clockwise, not wrapped.
    """

    time_s: float
    center_px: complex
    heading_rad: float
    side_px: float
    commanded_sides: ComplexArray
    commanded_rad: Array

    def seen_since(self, before: "SeenPose") -> Array:
        """Return the motion (3,) in the image since another pose: forward and left, sides, and turn, rad.

        The image's v axis points down, so that left and counter-clockwise are negative there.
        """
        moved = (self.center_px - before.center_px) / before.side_px * np.exp(-1j * before.heading_rad)
        return np.array([moved.real, -moved.imag, before.heading_rad - self.heading_rad])

    def commanded_since(self, before: "SeenPose") -> Array:
        """Return the commanded motions (L, 3) since another pose, as `seen_since`."""
        moved = (self.commanded_sides - before.commanded_sides) * np.exp(-1j * before.commanded_rad)
        return np.stack([moved.real, moved.imag, self.commanded_rad - before.commanded_rad], axis=1)


class MotionCheck:
    """Comparison of one robot's motion in the images of one unit with its commands.

    Args:
        limits: (2,) the robot's greatest speed, sides/s, and turn rate, rad/s.
        is_fixed: whether the unit does not fly, so that displacements in its images count.
    """

    def __init__(self, limits: Array, *, is_fixed: bool) -> None:
        self._limits, self._is_fixed = limits, is_fixed
        self._steps: deque[tuple[Array, Array, float]] = deque(maxlen=STEPS)
        self._start: SeenPose | None = None
        self._last: SeenPose | None = None

    def look(self, pose: SeenPose) -> str:
        """Add the marker's pose in an image, and return the fault, `STANDS` or `STRAYS`, or an empty string.

        Images that are not newer than the last one are ignored.
        """
        start, last = self._start, self._last
        if last is not None and pose.time_s <= last.time_s:
            return ""
        if last is None or start is None or not self._continues(pose, last):
            self._start = self._last = pose
            return ""
        # Headings go on from the last one, so that a step may have several turns.
        turned = np.angle(np.exp(1j * (pose.heading_rad - last.heading_rad)))
        pose = self._last = replace(pose, heading_rad=last.heading_rad + float(turned))
        if pose.time_s - start.time_s < STEP_S:
            return ""
        self._steps.append((pose.seen_since(start), pose.commanded_since(start), pose.time_s - start.time_s))
        self._start = pose
        return self._fault()

    def _continues(self, pose: SeenPose, last: SeenPose) -> bool:
        """Return whether the marker may have moved from one pose to the next while its image was followed."""
        if pose.time_s - last.time_s > MAX_GAP_S:
            return False
        moved_sides = abs(pose.center_px - last.center_px) / last.side_px
        told_sides = float(np.max(np.abs(pose.commanded_sides - last.commanded_sides)))
        return not self._is_fixed or moved_sides <= MAX_JUMP_SIDES + told_sides

    def _fault(self) -> str:
        """Return the fault that the last steps show, or an empty string."""
        if len(self._steps) < MIN_STEPS:
            return ""
        used = slice(0, 3) if self._is_fixed else slice(2, 3)
        seen, commanded = (
            np.array(motions)[..., used] for motions in list(zip(*self._steps, strict=True))[:2]
        )
        seen_norm, told_norms = np.linalg.norm(seen), np.linalg.norm(commanded, axis=(0, 2))
        if max(seen_norm, told_norms.max()) < MIN_MOTION:
            return ""
        products = np.einsum("ni,nli->l", seen, commanded)
        stands = seen_norm < RESPONSE * told_norms
        strays = (products < ALIKE * seen_norm * told_norms) | (told_norms < RESPONSE * seen_norm)
        if not (stands | strays).all() or (stands.any() and self._told_pace() < FULL_PACE):
            return ""
        return STANDS if stands.all() else STRAYS

    def _told_pace(self) -> float:
        """Return the root mean square of the commanded paces, as a share of the limits."""
        paces = [commanded[0] / duration_s for _, commanded, duration_s in self._steps]
        return float(np.linalg.norm(np.array(paces) / self._limits[[0, 0, 1]]) / len(paces) ** 0.5)


class MotionChecks:
    """Checks of one robot's motion in the images of all units that see it.

    Attributes:
        MAX_LAG_S: longest time before an image, s, for which the reckoning has to remember poses.

    Args:
        robot_id: id of the robot's marker.
        fixed_units: by unit whose images count, whether it does not fly.
        reckoning: dead-reckoned poses of the robot, the only one in it.
        max_speed_mps: greatest commanded speed.
        max_turn_radps: greatest commanded turn rate.
    """

    MAX_LAG_S = max(LAGS_S)

    def __init__(
        self,
        robot_id: int,
        fixed_units: Mapping[int, bool],
        reckoning: LatencyCompensation,
        *,
        max_speed_mps: float,
        max_turn_radps: float,
    ) -> None:
        self._robot_id, self._fixed_units, self._reckoning = robot_id, fixed_units, reckoning
        self._max_speed_mps, self._max_turn_radps = max_speed_mps, max_turn_radps
        self._checks: dict[int, MotionCheck] = {}

    def reset(self) -> None:
        """Forget all motions."""
        self._checks.clear()

    def look(self, sighting: Sighting, taken_s: float) -> str:
        """Add an image of a unit with the robot's marker; return the fault as `MotionCheck.look` does.

        Args:
            sighting: the markers of the image.
            taken_s: time of the image on the robot's clock.
        """
        if (is_fixed := self._fixed_units.get(sighting.unit_id)) is None:
            return ""
        row = int(np.flatnonzero(sighting.ids == self._robot_id)[0])
        places_m, headings_rad = self._reckoning.marker_poses(taken_s - np.array(LAGS_S))
        pose = SeenPose(
            time_s=taken_s,
            center_px=complex(*sighting.centers_px[row]),
            heading_rad=float(sighting.headings_rad[row]),
            side_px=float(sighting.sides_px[row]),
            commanded_sides=places_m[:, 0] / self._reckoning.side_m,
            commanded_rad=headings_rad[:, 0],
        )
        if sighting.unit_id not in self._checks:
            limits = np.array([self._max_speed_mps / self._reckoning.side_m, self._max_turn_radps])
            self._checks[sighting.unit_id] = MotionCheck(limits, is_fixed=is_fixed)
        return self._checks[sighting.unit_id].look(pose)
