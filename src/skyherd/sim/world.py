"""Ground truth: unicycle robots on the ground, and aerial units with their autopilots.

Robots have unicycle kinematics and units single-integrator kinematics, as in the paper (Sections II and VI).
Quantities are in the ground frame: x, y in metres, angles counter-clockwise from +x. `control` never has
access to them. `skyherd.sim.physics` provides the numbers of a scenario.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, IntArray, to_complex, to_points, wrap_angle
from skyherd.markers.layout import MarkerLayout, Place
from skyherd.messages import FlightCommand, VelocityCommand
from skyherd.render import Camera, CameraPose, Imaging, Motion, facing_rows
from skyherd.sim.drive import Drive
from skyherd.sim.sway import Sway

MIN_SPEED_MPS = 1e-12
"""Minimum divisor of speeds, m/s. Chosen: far below any flight speed; it only avoids 0 / 0."""


def move_unicycles(
    positions_m: Array, headings_rad: Array, v_mps: Array, omega_radps: Array, step_s: float
) -> tuple[Array, Array]:
    """Return positions (N, 2) and headings (N,) of unicycles after `step_s` at constant v and ω.

    The motion is an exact arc. The chord of an arc with the turn `a = ω t` has the length
    `v t sin(a/2) / (a/2)` and the mean direction of the two headings. This also holds for a = 0.
    """
    turned_rad = omega_radps * step_s
    length = v_mps * step_s * np.sinc(turned_rad / (2 * np.pi))
    chord = length * np.exp(1j * (headings_rad + turned_rad / 2))
    return positions_m + to_points(chord), wrap_angle(headings_rad + turned_rad)


def move_bodies(
    positions_m: Array,
    headings_rad: Array,
    v_mps: Array,
    omega_radps: Array,
    *,
    step_s: float,
    axis_offset_m: float,
) -> tuple[Array, Array]:
    """Move unicycles whose body centres lie `axis_offset_m` ahead of their wheel axes; see `move_unicycles`.

    v is the speed of the axis, which moves on an exact arc. Positions (N, 2) are those of the body centres.
    """
    if not axis_offset_m:
        return move_unicycles(positions_m, headings_rad, v_mps, omega_radps, step_s)
    ahead = axis_offset_m * np.exp(1j * headings_rad)
    axes_m, turned = move_unicycles(positions_m - to_points(ahead), headings_rad, v_mps, omega_radps, step_s)
    return axes_m + to_points(axis_offset_m * np.exp(1j * turned)), turned


@dataclass(frozen=True)
class Markers:
    """M markers.

    Attributes:
        ids: (M,) ids.
        positions_m: (M, 2) centres on the ground; with `frames`, reference points of their robots.
        headings_rad: (M,) headings; with `frames`, of their robots.
        frames: (M, 3, 3) places on the robots, as in `skyherd.render.Shot`; None for markers on the ground.
    """

    ids: IntArray
    positions_m: Array
    headings_rad: Array
    frames: Array | None = None

    def take(self, rows: IntArray) -> "Markers":
        """Return the markers of some rows."""
        frames = None if self.frames is None else self.frames[rows]
        return Markers(self.ids[rows], self.positions_m[rows], self.headings_rad[rows], frames)


@dataclass(frozen=True)
class UnitParameters:
    """Parameters of one aerial unit: camera, start, and autonomous motion of gimbal and lens.

    Attributes:
        camera: the camera at a zoom of 1.
        position_m: start on the ground plane.
        height_m: height of the camera at the start.
        yaw_rad: yaw at the start.
        tilt_rad: constant tilts about the camera's u and v axes.
        zoom_times_s: (K,) times, ascending, of the prescribed zooms.
        zooms: (K,) factors on the focal length at these times; linear between, constant outside.
        zoom_range: minimum and maximum of the unit's own additional zoom factor.
        sway: additional random tilts; None for none.
    """

    camera: Camera
    position_m: tuple[float, float]
    height_m: float
    yaw_rad: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    zoom_times_s: Sequence[float] = (0.0,)
    zooms: Sequence[float] = (1.0,)
    zoom_range: tuple[float, float] = (1.0, 1.0)
    sway: Sway | None = None


@dataclass(frozen=True)
class AutopilotLimits:
    """Limits enforced by the autopilots of all units.

    Attributes:
        min_height_m: minimum height.
        max_height_m: maximum height.
        max_speed_mps: limit of the horizontal speed.
        max_climb_mps: limit of the vertical speed.
        max_yaw_rate_radps: limit of the yaw rate.
    """

    min_height_m: float
    max_height_m: float
    max_speed_mps: float
    max_climb_mps: float
    max_yaw_rate_radps: float


@dataclass(frozen=True)
class Fleet:
    """State of the U aerial units.

    Attributes:
        positions_m: (U, 2) positions on the ground plane.
        heights_m: (U,) heights of the cameras.
        yaws_rad: (U,) yaws; at yaw ψ the camera's +u lies along (cos ψ, sin ψ).
        tilts_rad: (U, 2) tilts about the cameras' u and v axes.
        zooms: (U,) factors on the focal lengths.
    """

    positions_m: Array
    heights_m: Array
    yaws_rad: Array
    tilts_rad: Array
    zooms: Array

    def pose(self, unit: int) -> CameraPose:
        """Return the pose of one unit's camera."""
        x, y = self.positions_m[unit].tolist()
        tilt_u, tilt_v = self.tilts_rad[unit].tolist()
        return CameraPose(
            position_m=(x, y),
            height_m=float(self.heights_m[unit]),
            yaw_rad=float(self.yaws_rad[unit]),
            tilt_rad=(tilt_u, tilt_v),
            zoom=float(self.zooms[unit]),
        )


def _fly(fleet: Fleet, commands: Sequence[FlightCommand], *, limits: AutopilotLimits, step_s: float) -> Fleet:
    """Return the fleet after `step_s`: single integrators with limited speeds, in their cameras' axes."""
    lateral = np.array([command.lateral_mps for command in commands])
    speed = np.linalg.norm(lateral, axis=1, keepdims=True)
    lateral *= np.minimum(1.0, limits.max_speed_mps / np.maximum(speed, MIN_SPEED_MPS))
    climb = np.clip([c.climb_mps for c in commands], -limits.max_climb_mps, limits.max_climb_mps)
    most = limits.max_yaw_rate_radps
    yaw_rate = np.clip([c.yaw_rate_radps for c in commands], -most, most)
    moved = to_points(to_complex(lateral).conj() * np.exp(1j * fleet.yaws_rad)) * step_s
    return replace(
        fleet,
        positions_m=fleet.positions_m + moved,
        heights_m=np.clip(fleet.heights_m + climb * step_s, limits.min_height_m, limits.max_height_m),
        yaws_rad=wrap_angle(fleet.yaws_rad + yaw_rate * step_s),
        zooms=fleet.zooms * np.exp(np.array([c.zoom_rate_ps for c in commands]) * step_s),
    )


def _with_row(array: Array, row: int, value: npt.ArrayLike) -> Array:
    """Return a copy of an array with another value of one row; steps keep the arrays of the world."""
    changed = array.copy()
    changed[row] = value
    return changed


class World:
    """True state of robots, obstacles and aerial units; `control` never has access to it.

    Attributes:
        ids: (N,) robots.
        positions_m: (N, 2) reference points of the robots: the centres of their markers, if each has one.
        headings_rad: (N,) headings of the robots.
        fleet: state of the aerial units.
        cameras: (U,) cameras of the units, at a zoom of 1.
        imaging: (U,) values of single cameras instead of those of all.
        frame_losses: (U,) shares of the cameras' images that are lost.
        covered_ids: markers of robots and obstacles that are covered by a card.

    Args:
        robots: the robots at the start.
        obstacles: markers of the static obstacles.
        drive: drives of the robots, at rest.
        units: the aerial units.
        autopilot: limits of their flight.
        radio_range_m: radio range between units, on the ground plane; None for no limit.
        frame_loss: share of the images of each camera that is lost.
        layout: the markers on the robots; None for one on each, at its reference point.
        side_m: side of the markers, the unit of the layout.
    """

    def __init__(
        self,
        *,
        robots: Markers,
        obstacles: Markers,
        drive: Drive,
        units: Sequence[UnitParameters],
        autopilot: AutopilotLimits,
        radio_range_m: float | None = None,
        frame_loss: float = 0.0,
        layout: MarkerLayout | None = None,
        side_m: float = 1.0,
    ) -> None:
        self.ids = robots.ids
        self.positions_m, self.headings_rad = robots.positions_m.copy(), robots.headings_rad.copy()
        self.cameras = [unit.camera for unit in units]
        self.imaging = [Imaging()] * len(units)
        self.frame_losses = [frame_loss] * len(units)
        self.covered_ids: set[int] = set()
        self._obstacles, self._drive, self._autopilot = obstacles, drive, autopilot
        alone = MarkerLayout.make(robots.ids, [Place(0, (0.0, 0.0))])
        self._layout = alone if layout is None else layout
        self._rows = np.searchsorted(robots.ids, self._layout.robot_ids)
        self._side_m, self._is_flat = side_m, self._layout.is_flat
        self._offsets_m = side_m * self._layout.offsets_sides * self._is_flat
        self._units, self._radio_range_m = list(units), radio_range_m
        self._time_s = 0.0
        self._tilts_rad = np.array([unit.tilt_rad for unit in units])
        self._zoom_limits = np.array([unit.zoom_range for unit in units], dtype=float).T
        self.fleet = Fleet(
            positions_m=np.array([unit.position_m for unit in units]),
            heights_m=np.array([unit.height_m for unit in units]),
            yaws_rad=np.array([unit.yaw_rad for unit in units]),
            tilts_rad=self._swayed(0.0),
            zooms=self._limited(np.ones(len(units)), 0.0),
        )
        self._rates = (np.zeros_like(self.positions_m), np.zeros_like(self.headings_rad))
        self._fleet_before, self._step_s = self.fleet, 1.0
        self._commands = [
            FlightCommand(unit, np.zeros(2), climb_mps=0.0, yaw_rate_radps=0.0) for unit in range(len(units))
        ]

    @property
    def markers(self) -> Markers:
        """All markers: first those of the robots, then those of the obstacles."""
        obstacles, headings_rad = self._obstacles, self.headings_rad[self._rows]
        ids = np.concatenate([self._layout.ids, obstacles.ids])
        positions_m = np.concatenate([self.positions_m[self._rows] + self._arms_m(), obstacles.positions_m])
        if self._is_flat:
            headings_rad = headings_rad + self._layout.yaws_rad
            return Markers(ids, positions_m, np.concatenate([headings_rad, obstacles.headings_rad]))
        on_ground = np.tile(np.diag([1.0, 1.0, 0.0]), (obstacles.ids.size, 1, 1))
        return Markers(
            ids,
            positions_m,
            np.concatenate([headings_rad, obstacles.headings_rad]),
            np.concatenate([self._layout.frames, on_ground]),
        )

    def markers_facing(self, unit: int) -> Markers:
        """Return the markers that face one unit's camera, in the order in which they are drawn."""
        markers = self.markers
        rows = self._rows_facing(unit, markers)
        return markers if rows is None else markers.take(rows)

    def _rows_facing(self, unit: int, markers: Markers) -> IntArray | None:
        """Return the rows of the markers that face one unit's camera; None for all, on the ground."""
        if markers.frames is None:
            return None
        pose = self.camera_pose(unit)
        return facing_rows(pose, markers.positions_m, markers.headings_rad, self._side_m, markers.frames)

    def _arms_m(self) -> Array:
        """Return the vectors (M, 2) on the ground from the robots to the positions of their markers."""
        return to_points(self._offsets_m * np.exp(1j * self.headings_rad[self._rows]))

    def place_robot(self, robot: int, position_m: npt.ArrayLike, heading_rad: float) -> None:
        """Put a robot at a position (2,), m, with a heading, at rest until the next step."""
        row = int(np.flatnonzero(self.ids == robot)[0])
        mps, radps = self._rates
        self.positions_m = _with_row(self.positions_m, row, position_m)
        self.headings_rad = _with_row(self.headings_rad, row, heading_rad)
        self._rates = _with_row(mps, row, 0.0), _with_row(radps, row, 0.0)

    def place_unit(self, unit: int, position_m: npt.ArrayLike, height_m: float, yaw_rad: float) -> None:
        """Put an aerial unit at a position (2,), m, a height and a yaw, at rest until the next step."""
        self.fleet, self._fleet_before = (
            replace(
                fleet,
                positions_m=_with_row(fleet.positions_m, unit, position_m),
                heights_m=_with_row(fleet.heights_m, unit, height_m),
                yaws_rad=_with_row(fleet.yaws_rad, unit, yaw_rad),
            )
            for fleet in (self.fleet, self._fleet_before)
        )

    def change_unit(self, unit: int, parameters: UnitParameters) -> None:
        """Give a unit another camera, constant tilt and prescribed zoom; it stays where it is."""
        flown = self.fleet.zooms / self._prescribed_zooms(self._time_s)
        self._units[unit], self.cameras[unit] = parameters, parameters.camera
        self._tilts_rad = _with_row(self._tilts_rad, unit, parameters.tilt_rad)
        tilts_rad, zooms = self._swayed(self._time_s), self._limited(flown, self._time_s)
        self.fleet = replace(self.fleet, tilts_rad=tilts_rad, zooms=zooms)

    def camera_pose(self, unit: int) -> CameraPose:
        """Return the present pose of one unit's camera."""
        return self.fleet.pose(unit)

    def motion(self, unit: int) -> Motion:
        """Return the velocities of one unit's camera and of `markers_facing` it, for motion blur and shutter.

        They are means over the last step, and zero before the first step. The rates of the sway are
        instantaneous.
        """
        old, new = self._fleet_before, self.fleet
        x, y = ((new.positions_m[unit] - old.positions_m[unit]) / self._step_s).tolist()
        climb = float(new.heights_m[unit] - old.heights_m[unit]) / self._step_s
        yaw_rate = float(wrap_angle(new.yaws_rad[unit] - old.yaws_rad[unit])) / self._step_s
        still, (mps, radps) = self._obstacles.ids.size, self._rates
        arms_m, turns_radps = self._arms_m(), radps[self._rows]
        marker_mps = mps[self._rows] + turns_radps[:, None] * np.stack([-arms_m[:, 1], arms_m[:, 0]], axis=1)
        sway = self._units[unit].sway
        tilt_u, tilt_v = (0.0, 0.0) if sway is None else sway.rates_at(self._time_s).tolist()
        marker_mps, turns_radps = np.pad(marker_mps, ((0, still), (0, 0))), np.pad(turns_radps, (0, still))
        if (facing := self._rows_facing(unit, self.markers)) is not None:
            marker_mps, turns_radps = marker_mps[facing], turns_radps[facing]
        return Motion(
            camera_mps=(x, y, climb),
            yaw_rate_radps=yaw_rate,
            robots_mps=marker_mps,
            robots_radps=turns_radps,
            tilt_rates_radps=(tilt_u, tilt_v),
        )

    def in_range(self) -> list[list[int]] | None:
        """Return, for each unit, the units that receive its radio, itself included; None without a limit."""
        if self._radio_range_m is None:
            return None
        places_m = self.fleet.positions_m
        apart_m = np.linalg.norm(places_m[:, None] - places_m, axis=2)
        return [np.flatnonzero(row).tolist() for row in apart_m <= self._radio_range_m]

    def fly(self, command: FlightCommand) -> None:
        """Set the velocity command of a unit's autopilot, valid until the next command."""
        self._commands[command.unit_id] = command

    def limit(self, command: VelocityCommand) -> VelocityCommand:
        """Return a command as the robots accept it: v and ω within their limits."""
        return self._drive.limit(command)

    def advance(self, command: VelocityCommand, time_s: float, step_s: float) -> None:
        """Move robots and units from `time_s` to `time_s + step_s`.

        Args:
            command: command of all robots in order, within the limits.
            time_s: the time now.
            step_s: the time step.
        """
        offset_m = self._drive.parameters.axis_offset_m
        v_mps, omega_radps = self._drive.step(command)
        self.positions_m, self.headings_rad = move_bodies(
            self.positions_m, self.headings_rad, v_mps, omega_radps, step_s=step_s, axis_offset_m=offset_m
        )
        forward = np.column_stack([np.cos(self.headings_rad), np.sin(self.headings_rad)])
        left = np.column_stack([-forward[:, 1], forward[:, 0]])
        self._rates = v_mps[:, None] * forward + offset_m * omega_radps[:, None] * left, omega_radps
        self._fleet_before, self._step_s = self.fleet, step_s
        fleet = _fly(self.fleet, self._commands, limits=self._autopilot, step_s=step_s)
        zooms = self._limited(fleet.zooms / self._prescribed_zooms(time_s), time_s + step_s)
        self._time_s = time_s + step_s
        self.fleet = replace(fleet, tilts_rad=self._swayed(self._time_s), zooms=zooms)

    def _swayed(self, time_s: float) -> Array:
        """Return the tilts (U, 2), rad: constant tilts plus sway."""
        sways = (unit.sway for unit in self._units)
        return self._tilts_rad + [np.zeros(2) if s is None else s.tilts_rad(time_s) for s in sways]

    def _prescribed_zooms(self, time_s: float) -> Array:
        """Return the zooms (U,) that the units' parameters prescribe at a time."""
        return np.array([np.interp(time_s, unit.zoom_times_s, unit.zooms) for unit in self._units])

    def _limited(self, flown: Array, time_s: float) -> Array:
        """Return the zooms (U,): the prescribed ones times the units' own factors (U,), which are clipped."""
        return np.asarray(self._prescribed_zooms(time_s) * np.clip(flown, *self._zoom_limits))
