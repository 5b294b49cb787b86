"""A checked lab, which makes the cores of its unit and robot processes."""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from skyherd.assembly import (
    REPORT_LIFETIME_S,
    REPORTS_MISSED,
    make_body_rule,
    make_flight,
    make_roles,
    make_selection,
    make_size,
)
from skyherd.control import (
    AerialController,
    AvoidanceRule,
    CameraRule,
    Hover,
    MarkerGains,
    Rectifier,
    TeamClock,
    Template,
    Wheels,
)
from skyherd.datasets import RolesModel
from skyherd.errors import InputError
from skyherd.geometry import Image
from skyherd.live.drivers.addresses import DRY_RUN
from skyherd.live.drivers.driver import HOLD_S, RATE_HZ
from skyherd.live.drivers.limits import SpeedLimits
from skyherd.live.lab.checks import make_lab_layout
from skyherd.live.lab.models import LabCamera, LabModel, LabRobot
from skyherd.live.peers import ClockLimits
from skyherd.live.robot_core import RobotCore, RobotLimits
from skyherd.live.unit_core import UnitCore
from skyherd.markers.layout import MarkerLayout
from skyherd.messages import Detections
from skyherd.poses import Calibration, read_calibration
from skyherd.sim.robot_teams import Timing, make_avoidance_rule
from skyherd.vision import fuse_markers

NOMINAL_AGE_SHARE = 0.5
"""Image age for which avoidance allows the fastest approach and after which goals show an effect, as a share
of `goal_timeout_s`. Chosen: a typical age. It does not affect the bound on approach speeds."""


@dataclass(frozen=True)
class Lab:
    """A checked lab.

    Attributes:
        model: content of the file.
        template: the shape, with a point for each robot.
        folder: folder to which file names are relative.
    """

    model: LabModel
    template: Template
    folder: Path

    @property
    def ids(self) -> list[int]:
        """Numbers of the robots, ascending; their marker ids, if each has one."""
        return sorted(robot.id for robot in self.model.robots)

    @cached_property
    def digest(self) -> str:
        """Return a digest of all that the processes of a team must agree on: 16 hexadecimal digits.

        Left out is what may differ from machine to machine: addresses, radio and recording.
        """
        own: dict[str, Any] = {"radio": True, "recording": True, "robots": {"__all__": {"driver"}}}
        own["cameras"] = {"__all__": {"address", "driver", "calibration"}}
        content = self.model.model_dump_json(exclude=own)
        return hashlib.sha256(content.encode()).hexdigest()[:16]

    @cached_property
    def layout(self) -> MarkerLayout | None:
        """The markers on the robots; None if each has one, at its reference point."""
        return make_lab_layout(self.model)

    def robots_of(self, found: Detections, image: Image) -> Detections:
        """Return the robots in an image (height, width), from the detections of their markers."""
        if self.layout is None:
            return found
        return fuse_markers(found, self.layout, image, self.model.markers.dictionary)

    def robot(self, robot_id: int) -> LabRobot:
        """Return the entry of the robot with a marker id.

        Raises:
            InputError: no robot has this marker.
        """
        for robot in self.model.robots:
            if robot.id == robot_id:
                return robot
        raise InputError("robot", f"no robot {robot_id} in this lab", f"one of {self.ids}")

    def camera(self, unit: int) -> LabCamera:
        """Return the entry of the unit with a number from 0.

        Raises:
            InputError: no unit has this number.
        """
        if not 0 <= unit < len(self.model.cameras):
            raise InputError("unit", f"no unit {unit} in this lab", f"0 to {len(self.model.cameras) - 1}")
        return self.model.cameras[unit]

    def calibration(self, unit: int) -> Calibration | None:
        """Read the intrinsics of a unit's camera, for recordings alone; None if the lab names none.

        Raises:
            InputError: the file cannot be read, or no unit has this number.
        """
        file = self.camera(unit).calibration
        if file is None:
            return None
        try:
            return read_calibration(str(self.folder / file))
        except InputError as error:
            raise InputError(
                f"cameras.{unit}.calibration: {error.where}", error.what, error.allowed
            ) from None

    def check_process(self, name: str) -> None:
        """Check the name of a process, such as `robot/3`.

        Raises:
            InputError: the lab has no such unit or robot.
        """
        kind, _, number = name.partition("/")
        if kind == "unit":
            self.camera(int(number))
        else:
            self.robot(int(number))

    def make_controller(self, unit: int) -> AerialController:
        """Return the controller of one unit: the simulator's, with the settings of the lab."""
        model = self.model
        flight = self.camera(unit).flight
        return AerialController(
            self.template,
            make_selection(model.selection),
            Hover(0.0) if flight is None else make_flight(flight, self.template),
            rectifier=Rectifier() if model.control.rectify else None,
            nearest=model.control.neighbors,
            report_lifetime_s=max(REPORT_LIFETIME_S, REPORTS_MISSED * model.limits.goal_timeout_s),
            roles=make_roles(RolesModel(exchange=model.shape.exchange)),
            size=make_size(model.shape.size, self.template, model.markers.side_m),
            bodies=make_body_rule(model.avoidance, model.avoidance.body_radius_sides, model.obstacles),
            clock=TeamClock(),
            camera=self.make_camera_rule() if model.control.camera_check else None,
        )

    def make_unit(self, unit: int) -> UnitCore:
        """Return the core of one unit: its decisions without I/O.

        Raises:
            InputError: no unit has this number.
        """
        return UnitCore(
            unit,
            self.make_controller(unit),
            oldest_s=self.model.limits.goal_timeout_s,
            clock_limits=self.clock_limits,
            lab=self.digest,
            unit_ids=range(len(self.model.cameras)),
        )

    @property
    def body_ids(self) -> list[int]:
        """Marker ids of robots and obstacles, ascending."""
        return sorted({*self.ids, *(obstacle.id for obstacle in self.model.obstacles)})

    @property
    def wheels(self) -> Wheels:
        """Limits of the robots' wheels."""
        limits = self.model.limits
        return Wheels(limits.max_speed_mps, limits.max_turn_radps, self.model.control.axis_offset_m)

    @property
    def command_life_s(self) -> float:
        """Longest time for which a robot follows a command without a new decision, s.

        A robot's process may stop right before its next decision. The driver's watchdog expires `HOLD_S`
        later, and the next write sends zero. If the driver stops too, the robot's own watchdog ends the last
        written command, after `HOLD_S` at most.
        """
        return HOLD_S + max(1 / RATE_HZ, self.model.limits.period_s)

    def make_avoidance(self) -> AvoidanceRule | None:
        """Return the bound on the robots' speed near other bodies; None if avoidance is off."""
        model, limits = self.model.avoidance, self.model.limits
        if not model.on:
            return None
        margin_s = limits.clock_uncertainty_s + model.stamp_error_s
        brakes = self.model.drive.max_accel_mps2 or limits.max_accel_mps2
        return make_avoidance_rule(
            model,
            self.model.drive.model_copy(update={"max_accel_mps2": brakes}),
            self.wheels,
            side_m=self.model.markers.side_m,
            timing=Timing(
                nominal_age_s=NOMINAL_AGE_SHARE * limits.goal_timeout_s,
                superseded_age_s=0.0,
                step_s=self.command_life_s,
                delay_s=self.model.control.delay_s,
                clock_margin_s=margin_s,
                bearing_s=margin_s + self.command_life_s - HOLD_S,
                is_synchronous=False,
            ),
        )

    def make_camera_rule(self) -> CameraRule:
        """Return the robots' response to goals, by which units check their cameras."""
        limits = self.model.limits
        accel_mps2 = self.model.drive.max_accel_mps2 or limits.max_accel_mps2
        return CameraRule(
            self.make_law(),
            side_m=self.model.markers.side_m,
            max_speed_mps=limits.max_speed_mps,
            lag_s=NOMINAL_AGE_SHARE * limits.goal_timeout_s
            + self.model.control.delay_s
            + limits.max_speed_mps / accel_mps2 / 2,
            avoidance=self.make_avoidance(),
            has_operator=True,
        )

    def make_law(self) -> MarkerGains:
        """Return the speed law of the robots."""
        control = self.model.control
        return MarkerGains(
            k=control.k, k_omega=control.k_omega, b_th=control.b_th, side_m=self.model.markers.side_m
        )

    @property
    def clock_limits(self) -> ClockLimits:
        """Limits beyond which another process's clock is not trusted."""
        limits = self.model.limits
        return ClockLimits(limits.clock_offset_s, limits.clock_uncertainty_s)

    @property
    def speed_limits(self) -> SpeedLimits:
        """Limits of a robot's speeds and accelerations."""
        limits = self.model.limits
        return SpeedLimits(
            limits.max_speed_mps,
            limits.max_turn_radps,
            limits.max_accel_mps2,
            limits.max_turn_accel_radps2,
        )

    def make_robot(self, robot_id: int, *, supervised: bool = False, dry_run: bool = False) -> RobotCore:
        """Return the core of one robot: its decisions without I/O.

        Args:
            robot_id: number of the robot.
            supervised: whether a session runs the robot, without which it must not drive.
            dry_run: whether its commands are not sent, so that it need not move.

        Raises:
            InputError: no robot has this marker.
        """
        driver, control, limits = self.robot(robot_id).driver, self.model.control, self.model.limits
        moves = driver != DRY_RUN and not dry_run
        fixed = {unit: camera.flight is None for unit, camera in enumerate(self.model.cameras)}
        return RobotCore(
            robot_id,
            list(range(len(self.model.cameras))),
            self.make_law(),
            self.wheels,
            RobotLimits(self.speed_limits, goal_timeout_s=limits.goal_timeout_s, unseen_s=limits.unseen_s),
            side_m=self.model.markers.side_m,
            delay_s=control.delay_s,
            clock_limits=self.clock_limits,
            other_ids=self.body_ids if self.model.avoidance.on else [],
            avoidance=self.make_avoidance(),
            lab=self.digest,
            supervised=supervised,
            fixed_units=fixed if moves and control.motion_check else {},
        )
