"""The truth: unicycle robots, and aerial units with their autopilots."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skyherd.datasets import AutopilotModel, Mission, Scenario, UnitModel
from skyherd.geometry import Array, IntArray, to_complex, to_points, wrap_angle
from skyherd.messages import FlightCommand, VelocityCommand
from skyherd.random_streams import RunStream, generator
from skyherd.render import CameraPose, Motion
from skyherd.sim.drive import Drive, limit
from skyherd.sim.sway import Sway


def move_unicycles(
    positions_m: Array, headings_rad: Array, v_mps: Array, omega_radps: Array, step_s: float
) -> tuple[Array, Array]:
    """Positions (N, 2) and headings (N,) after `step_s` at constant v and omega: exact arcs.

    The chord of an arc that turns by `a = omega t` is `v t sin(a/2)/(a/2)` long and points along the mean
    heading, which holds for a = 0 too.
    """
    turn = omega_radps * step_s
    chord = v_mps * step_s * np.sinc(turn / (2 * np.pi)) * np.exp(1j * (headings_rad + turn / 2))
    return positions_m + to_points(chord), wrap_angle(headings_rad + turn)


def move_bodies(
    positions_m: Array,
    headings_rad: Array,
    v_mps: Array,
    omega_radps: Array,
    step_s: float,
    axis_offset_m: float,
) -> tuple[Array, Array]:
    """`move_unicycles` for bodies whose centres lie `axis_offset_m` ahead of their axes, which v is of."""
    if not axis_offset_m:
        return move_unicycles(positions_m, headings_rad, v_mps, omega_radps, step_s)
    ahead = axis_offset_m * np.exp(1j * headings_rad)
    axes_m, turned = move_unicycles(positions_m - to_points(ahead), headings_rad, v_mps, omega_radps, step_s)
    return axes_m + to_points(axis_offset_m * np.exp(1j * turned)), turned


@dataclass(frozen=True)
class Markers:
    """All markers on the ground, M of them, the robots' first: ids (M,), places (M, 2), headings (M,)."""

    ids: IntArray
    positions_m: Array
    headings_rad: Array


@dataclass(frozen=True)
class Fleet:
    """State of the aerial units: positions (U, 2), heights (U,), yaws (U,), tilts (U, 2), zooms (U,)."""

    positions_m: Array
    heights_m: Array
    yaws_rad: Array
    tilts_rad: Array
    zooms: Array

    def pose(self, unit: int) -> CameraPose:
        """Where one unit's camera is."""
        x, y = self.positions_m[unit].tolist()
        tilt_u, tilt_v = self.tilts_rad[unit].tolist()
        return CameraPose(
            position_m=(x, y),
            height_m=float(self.heights_m[unit]),
            yaw_rad=float(self.yaws_rad[unit]),
            tilt_rad=(tilt_u, tilt_v),
            zoom=float(self.zooms[unit]),
        )


def _fly(fleet: Fleet, commands: Sequence[FlightCommand], limits: AutopilotModel, step_s: float) -> Fleet:
    """Single integrators with limited speeds, each in its camera's axes, kept between two heights."""
    lateral = np.array([command.lateral_mps for command in commands])
    speed = np.linalg.norm(lateral, axis=1, keepdims=True)
    lateral *= np.minimum(1.0, limits.max_speed_mps / np.maximum(speed, 1e-12))
    climb = np.clip([c.climb_mps for c in commands], -limits.max_climb_mps, limits.max_climb_mps)
    most = np.radians(limits.max_yaw_rate_degps)
    yaw_rate = np.clip([c.yaw_rate_radps for c in commands], -most, most)
    moved = to_points(to_complex(lateral).conj() * np.exp(1j * fleet.yaws_rad)) * step_s
    return replace(
        fleet,
        positions_m=fleet.positions_m + moved,
        heights_m=np.clip(fleet.heights_m + climb * step_s, limits.min_height_m, limits.max_height_m),
        yaws_rad=wrap_angle(fleet.yaws_rad + yaw_rate * step_s),
        zooms=fleet.zooms * np.exp(np.array([c.zoom_rate_ps for c in commands]) * step_s),
    )


class World:
    """Robots and units as they are; `control` never sees it.

    Attributes:
        ids: (N,) robots.
        positions_m: (N, 2).
        headings_rad: (N,).
        fleet: the aerial units.
        cameras: one for each unit.
    """

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.scenario: Scenario = mission.scenario
        self.ids = mission.ids
        self.positions_m, self.headings_rad = mission.positions_m.copy(), mission.headings_rad.copy()
        units: list[UnitModel] = self.scenario.units
        self.cameras = [unit.camera.make() for unit in units]
        self._time_s = 0.0
        self._tilts_rad = np.radians([unit.tilt_deg for unit in units])
        self._sways = [self._draw_sway(number, unit) for number, unit in enumerate(units)]
        self._zooms = [np.array(unit.zoom, dtype=float).T for unit in units]
        self._zoom_limits = np.array([unit.zoom_range for unit in units], dtype=float).T
        self.fleet = Fleet(
            positions_m=np.array([unit.position_m for unit in units]),
            heights_m=np.array([unit.height_m for unit in units]),
            yaws_rad=np.radians([unit.yaw_deg for unit in units]),
            tilts_rad=self._swayed(0.0),
            zooms=self._limited(np.ones(len(units)), 0.0),
        )
        robots = self.scenario.robots
        self._drive = Drive(robots.drive, self.ids.size, self.scenario.step_s, self.scenario.seed)
        self._rates = (np.zeros_like(self.positions_m), np.zeros_like(self.headings_rad))
        self._fleet_before, self._step_s = self.fleet, 1.0
        self._commands = [FlightCommand(unit, np.zeros(2), 0.0, 0.0) for unit in range(len(units))]

    @property
    def markers(self) -> Markers:
        """Where all markers are: those of the robots, then those of the obstacles."""
        mission = self.mission
        return Markers(
            np.concatenate([self.ids, mission.obstacle_ids]),
            np.concatenate([self.positions_m, mission.obstacle_positions_m]),
            np.concatenate([self.headings_rad, mission.obstacle_headings_rad]),
        )

    def camera_pose(self, unit: int) -> CameraPose:
        """Where one unit's camera is now."""
        return self.fleet.pose(unit)

    def motion(self, unit: int) -> Motion:
        """Velocities of one unit's camera and of all markers over the last step; zero before the first.

        Those of its sway are of the instant itself.
        """
        old, new = self._fleet_before, self.fleet
        x, y = ((new.positions_m[unit] - old.positions_m[unit]) / self._step_s).tolist()
        climb = float(new.heights_m[unit] - old.heights_m[unit]) / self._step_s
        turn = float(wrap_angle(new.yaws_rad[unit] - old.yaws_rad[unit])) / self._step_s
        still, (mps, radps) = self.mission.obstacle_ids.size, self._rates
        sway = self._sways[unit]
        tilt_u, tilt_v = (0.0, 0.0) if sway is None else sway.rates_at(self._time_s).tolist()
        return Motion(
            (x, y, climb),
            turn,
            np.pad(mps, ((0, still), (0, 0))),
            np.pad(radps, (0, still)),
            tilt_rates_radps=(tilt_u, tilt_v),
        )

    def in_range(self) -> list[list[int]] | None:
        """Units that hear each unit's radio; None if all hear all."""
        range_m = self.scenario.network.range_m
        if range_m is None:
            return None
        places_m = self.fleet.positions_m
        apart_m = np.linalg.norm(places_m[:, None] - places_m, axis=2)
        return [np.flatnonzero(row).tolist() for row in apart_m <= range_m]

    def fly(self, command: FlightCommand) -> None:
        """Hand a unit's autopilot the velocity to fly until the next command."""
        self._commands[command.unit_id] = command

    def limit(self, command: VelocityCommand) -> VelocityCommand:
        """A command as the robots take it: v and omega within their limits."""
        return limit(command, self.scenario.robots)

    def advance(self, command: VelocityCommand, time_s: float, step_s: float) -> None:
        """Move all from `time_s` to `time_s + step_s`; `command` is for all robots, in order, and limited."""
        offset_m = self.scenario.robots.drive.axis_offset_m
        v_mps, omega_radps = self._drive.step(command)
        self.positions_m, self.headings_rad = move_bodies(
            self.positions_m, self.headings_rad, v_mps, omega_radps, step_s, offset_m
        )
        forward = np.column_stack([np.cos(self.headings_rad), np.sin(self.headings_rad)])
        left = np.column_stack([-forward[:, 1], forward[:, 0]])
        self._rates = v_mps[:, None] * forward + offset_m * omega_radps[:, None] * left, omega_radps
        self._fleet_before, self._step_s = self.fleet, step_s
        fleet = _fly(self.fleet, self._commands, self.scenario.autopilot, step_s)
        zooms = self._limited(fleet.zooms / self._scripted(time_s), time_s + step_s)
        self._time_s = time_s + step_s
        self.fleet = replace(fleet, tilts_rad=self._swayed(self._time_s), zooms=zooms)

    def _draw_sway(self, number: int, unit: UnitModel) -> Sway | None:
        if unit.sway is None:
            return None
        rng = generator(self.scenario.seed, RunStream.SWAY, number)
        return Sway.draw(float(np.radians(unit.sway.tilt_deg)), unit.sway.period_s, rng)

    def _swayed(self, time_s: float) -> Array:
        """Tilts (U, 2) that the scenario prescribes, and the sway on top."""
        return self._tilts_rad + [np.zeros(2) if s is None else s.tilts_rad(time_s) for s in self._sways]

    def _scripted(self, time_s: float) -> Array:
        """Zooms that the scenario prescribes."""
        return np.array(
            [np.interp(time_s, *plan) if len(plan[0]) > 1 else plan[1][0] for plan in self._zooms]
        )

    def _limited(self, flown: Array, time_s: float) -> Array:
        """Zooms as scripted, times what the units ask for within their lenses' ranges."""
        return np.asarray(self._scripted(time_s) * np.clip(flown, *self._zoom_limits))
