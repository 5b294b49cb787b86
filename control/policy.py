"""Interfaces of the exchangeable parts of a unit's controller and of the robots, and their data types.

`AerialController` (control/aerial_controller.py) calls its `SelectionPolicy` once per image. It calls its
`FlightLaw` unless the unit holds its position. The loop calls one `RobotTeam` per step. Each docstring below
is the complete contract of an implementation; `docs/extending.md` has an example of each.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.messages import (
    Detections,
    FlightCommand,
    MotionGoals,
    Proximity,
    TreeStatus,
    UnitReport,
    VelocityCommand,
)

NO_ROBOTS: IntArray = np.zeros(0, dtype=np.int64)
"""An empty set of robots."""


@dataclass(frozen=True)
class Selection:
    """Control set of a unit after an image, and further decisions of its policy.

    Attributes:
        controlled_ids: (M,) the control set S_j^c (paper, Section II), ascending.
        secure_ids: (L,) robots of the set that the unit holds reliably now; other units may release these to
            it.
        may_move: whether the unit sends goals; without goals its robots stop.
        sought_ids: robots outside the set that should also come into view; used while `may_move`.
        searches: whether the unit should widen its view and keep all visible robots, because units or robots
            are still missing. It is used only while `may_move` is False; otherwise the unit holds its
            position.
        tree_status: part of the unit's report about the tree; None without a tree.
    """

    controlled_ids: IntArray
    secure_ids: IntArray
    may_move: bool = True
    sought_ids: IntArray = field(default_factory=lambda: NO_ROBOTS)
    searches: bool = False
    tree_status: TreeStatus | None = None


class SelectionPolicy(Protocol):
    """Interface of a policy that selects the robots of one unit; one instance per unit, may keep state."""

    def choose(
        self, seen: Detections, reports: Sequence[UnitReport], shape: Template, last: UnitReport | None
    ) -> Selection:
        """Return the selection of the unit after one image.

        The controller calls it once per image, in the order of time. It must not draw random numbers or read
        a clock; the time is `seen.time_s`. It must tolerate message loss, delay, reordering and repetition.

        Args:
            seen: all robots of the team in the image, rectified if the unit rectifies; may be empty.
            reports: the last report of each other unit, never older than the controller's
                `report_lifetime_s`; a report may be several images old.
            shape: the template under the present roles; its `ids` are the team. The object is the same while
                nothing changes.
            last: the unit's own report after its last image; None at the first one.

        Returns:
            The selection. `controlled_ids` must be members of the team and may include robots outside the
            image, which get no goal now. `secure_ids` must be a subset of `controlled_ids`.
        """
        ...


@dataclass(frozen=True)
class FlightTask:
    """Robots that a unit must keep in view.

    Attributes:
        controlled_ids: the control set, which must stay in view.
        sought_ids: robots to bring into view as well, as far as the control set stays in view.
        widen: whether to widen the view continuously, to find missing units or robots.
        drift_mps: (2,) velocity along +u and +v at which a moving shape passes the image centre; a law that
            follows robots adds it.
    """

    controlled_ids: IntArray
    sought_ids: IntArray = field(default_factory=lambda: NO_ROBOTS)
    widen: bool = False
    drift_mps: Array = field(default_factory=lambda: np.zeros(2))


class FlightLaw(Protocol):
    """Interface of the flight law of one aerial unit, from image quantities alone; one instance per unit.

    Lengths are in halves of the image's shorter side, from the image centre (`skyherd.messages.centred`).
    Gains therefore do not depend on the camera. The autopilot, part of the world, limits height and speed.
    """

    def command(self, seen: Detections, task: FlightTask, reports: Sequence[UnitReport]) -> FlightCommand:
        """Return the velocity until the next image.

        It is not called while the unit holds its position. A law that measures time must use `seen.time_s`.

        Args:
            seen: robots of the team in the image; may be empty, and the law must return a command then as
                well.
            task: robots to keep in view. A law without a wider view may ignore `widen`.
            reports: the last recent report of each other unit.

        Returns:
            A command for `seen.unit_id`: lateral velocity along the image's +u and +v, climb, turn rate and
            zoom rate, all finite.
        """
        ...


@dataclass(frozen=True)
class Delivery:
    """Message of a unit to its robots, at its time of arrival.

    Attributes:
        message: goals, or gaps between bodies.
        received: (N,) mask of the robots in `message.ids` that received it; message loss affects the others.
    """

    message: MotionGoals | Proximity
    received: BoolArray


@dataclass(frozen=True)
class TeamOrders:
    """Commands of the robots until the next step.

    Attributes:
        command: speeds and turn rates of all robots.
        commanded_ids: robots that follow a goal now; the others are stopped by their watchdog.
        roles: (N,) template row of each robot, if the robots themselves choose their places; None otherwise.
    """

    command: VelocityCommand
    commanded_ids: IntArray
    roles: IntArray | None = None


class RobotTeam(Protocol):
    """Interface of the on-board computers of all robots: received messages to wheel speeds.

    A team that models real robots knows only its received messages, and computes each robot from that robot's
    messages alone. Laws from the literature that use ground truth share the interface
    (`skyherd.sim.oracle_team`). They therefore drive the same wheels in the same loop.
    """

    def decide(self, time_s: float, delivered: Sequence[Delivery]) -> TeamOrders:
        """Return the commands of all robots, given the messages that arrived since the last step.

        Args:
            time_s: present time; called once per step, in the order of time.
            delivered: messages in the order of arrival; a message may be older than an earlier one.

        Returns:
            Commands for all robots of the team, in the order of their ids, within the limits of the wheels.
        """
        ...
