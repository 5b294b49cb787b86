"""A checked lab, and what it says of each process: the controller of a unit, the computer of a robot."""

from dataclasses import dataclass
from pathlib import Path

from skyherd.assembly import (
    REPORT_LIFETIME_S,
    REPORTS_MISSED,
    make_flight,
    make_roles,
    make_selection,
    make_size,
)
from skyherd.control import (
    AerialController,
    Hover,
    MarkerGains,
    Rectifier,
    TeamClock,
    Template,
    Wheels,
)
from skyherd.datasets import RolesModel
from skyherd.errors import InputError
from skyherd.live.drivers.limits import SpeedLimits
from skyherd.live.lab.models import LabCamera, LabModel, LabRobot
from skyherd.live.peers import ClockLimits
from skyherd.live.robot_core import RobotCore, RobotLimits
from skyherd.live.unit_core import UnitCore


@dataclass(frozen=True)
class Lab:
    """A checked lab.

    Attributes:
        model: the file, key by key.
        template: the shape, a point for each robot.
        folder: the folder to which files are relative.
    """

    model: LabModel
    template: Template
    folder: Path

    @property
    def ids(self) -> list[int]:
        """The robots' markers, ascending."""
        return sorted(robot.id for robot in self.model.robots)

    def robot(self, robot_id: int) -> LabRobot:
        """The entry of one robot.

        Raises:
            InputError: there is none with this marker.
        """
        for robot in self.model.robots:
            if robot.id == robot_id:
                return robot
        raise InputError("robot", f"no robot {robot_id} in this lab", f"one of {self.ids}")

    def camera(self, unit: int) -> LabCamera:
        """The entry of one unit.

        Raises:
            InputError: there is none of this number.
        """
        if not 0 <= unit < len(self.model.cameras):
            raise InputError("unit", f"no unit {unit} in this lab", f"0 to {len(self.model.cameras) - 1}")
        return self.model.cameras[unit]

    def make_controller(self, unit: int) -> AerialController:
        """The controller of one unit: the simulator's, with what the file says."""
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
            clock=TeamClock(),
        )

    def make_unit(self, unit: int) -> UnitCore:
        """The computer of one unit.

        Raises:
            InputError: there is none of this number.
        """
        return UnitCore(
            unit,
            self.make_controller(unit),
            oldest_s=self.model.limits.goal_timeout_s,
            clock_limits=self.clock_limits,
        )

    @property
    def clock_limits(self) -> ClockLimits:
        """When another process's clock is not trusted."""
        limits = self.model.limits
        return ClockLimits(limits.clock_offset_s, limits.clock_uncertainty_s)

    @property
    def speed_limits(self) -> SpeedLimits:
        """What a robot may be told at most."""
        limits = self.model.limits
        return SpeedLimits(
            limits.max_speed_mps,
            limits.max_turn_radps,
            limits.max_accel_mps2,
            limits.max_turn_accel_radps2,
        )

    def make_robot(self, robot_id: int) -> RobotCore:
        """The computer of one robot.

        Raises:
            InputError: there is no robot with this marker.
        """
        self.robot(robot_id)
        control, limits = self.model.control, self.model.limits
        law = MarkerGains(
            k=control.k, k_omega=control.k_omega, b_th=control.b_th, side_m=self.model.markers.side_m
        )
        return RobotCore(
            robot_id,
            list(range(len(self.model.cameras))),
            law,
            Wheels(limits.max_speed_mps, limits.max_turn_radps, control.axis_offset_m),
            RobotLimits(self.speed_limits, goal_timeout_s=limits.goal_timeout_s, unseen_s=limits.unseen_s),
            side_m=self.model.markers.side_m,
            delay_s=control.delay_s,
            clock_limits=self.clock_limits,
        )
