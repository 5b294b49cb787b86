"""What can be exchanged in a unit's controller and in the robots: the interfaces and the values they pass.

`AerialController` (control/aerial_controller.py) calls its `SelectionPolicy` once an image, and its
`FlightLaw` unless the unit holds its place; the loop calls one `RobotTeam` a step. Each docstring below
states all that an implementation has to keep to; `docs/extending.md` shows one of each in full.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.geometry import BoolArray, IntArray
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
    """Which robots a unit controls after an image, and what else its policy decided.

    Attributes:
        controlled_ids: (M,) the control set S_j^c (paper, Section II), ascending.
        secure_ids: (L,) robots of the set that the unit holds safely now; other units may leave these to it.
        may_move: whether the unit sends goals; without goals its robots stand still.
        sought_ids: robots outside the set that the unit should also get into view; used while `may_move`.
        searches: whether the unit should widen its view and keep all robots that it sees, because units or
            robots have not been found yet; used only while `may_move` is False, else the unit holds its
            place.
        tree_status: what the unit's report says of the tree of units; None where there is no tree.
    """

    controlled_ids: IntArray
    secure_ids: IntArray
    may_move: bool = True
    sought_ids: IntArray = field(default_factory=lambda: NO_ROBOTS)
    searches: bool = False
    tree_status: TreeStatus | None = None


class SelectionPolicy(Protocol):
    """Decides which robots one unit controls. Each unit has an instance of its own, which may keep state."""

    def choose(
        self, seen: Detections, reports: Sequence[UnitReport], shape: Template, last: UnitReport | None
    ) -> Selection:
        """The unit's selection after one image.

        It is called once an image, in the order of time, and must not draw random numbers or read a clock:
        `seen.time_s` is the time. It must keep working whatever messages are lost, late or repeated.

        Args:
            seen: all robots of the team in the image, rectified if the unit rectifies; may be empty.
            reports: the last report that arrived from each other unit, none of them older than the
                controller's `report_lifetime_s`; a report may be several images old.
            shape: the template as the robots' roles are now; its `ids` are the team. The same object comes
                again while nothing changes.
            last: what this unit itself reported after its last image; None at the first one.

        Returns:
            The selection. `controlled_ids` may name robots that are not in the image (they get no goal now)
            and must be members of the team; `secure_ids` must be a subset of it.
        """
        ...


@dataclass(frozen=True)
class FlightTask:
    """What a unit is to have in view.

    Attributes:
        controlled_ids: the control set, which must stay in view.
        sought_ids: robots to be seen as well, as far as the control set stays in view.
        widen: whether to see more of the ground all the while, for units or robots that nobody has found.
    """

    controlled_ids: IntArray
    sought_ids: IntArray = field(default_factory=lambda: NO_ROBOTS)
    widen: bool = False


class FlightLaw(Protocol):
    """How one aerial unit flies, from image quantities alone. Each unit has an instance of its own.

    Lengths are in halves of the image's shorter side, from the image centre (`skyherd.messages.centred`), so
    that gains do not depend on the camera. Limits of height and speed are the autopilot's, in the world.
    """

    def command(self, seen: Detections, task: FlightTask, reports: Sequence[UnitReport]) -> FlightCommand:
        """Velocity to fly until the next image.

        It is not called while the unit holds its place: a law that counts time goes by `seen.time_s`.

        Args:
            seen: robots of the team in the image; may be empty, and the law must answer then as well.
            task: robots to be kept in view. A law that cannot widen its view may leave `widen` aside.
            reports: the last recent report of each other unit.

        Returns:
            A command for `seen.unit_id`: lateral velocity along the image's +u and +v, climb, turn and change
            of zoom, all finite.
        """
        ...


@dataclass(frozen=True)
class Delivery:
    """A message of a unit to its robots, at the instant at which it arrives.

    Attributes:
        message: goals, or gaps between bodies.
        received: (N,) which of the robots named in `message.ids` received it; the others lost it.
    """

    message: MotionGoals | Proximity
    received: BoolArray


@dataclass(frozen=True)
class TeamOrders:
    """What the robots do until the next step.

    Attributes:
        command: speeds and turn rates of all robots.
        commanded_ids: robots that follow a goal now; the others hold still for want of one.
    """

    command: VelocityCommand
    commanded_ids: IntArray


class RobotTeam(Protocol):
    """All robots' own computers at once: from the messages that arrive to speeds of the wheels.

    A team that stands for real robots knows what it received and nothing else, and computes each robot from
    that robot's messages alone. Laws from the literature that are given the truth keep to the same interface
    (`skyherd.sim.oracle_team`), so that they drive the same wheels in the same loop.
    """

    def decide(self, time_s: float, delivered: Sequence[Delivery]) -> TeamOrders:
        """What all robots do from now on, given the messages that arrived since the last step.

        Args:
            time_s: now; called once a step, in the order of time.
            delivered: in the order of arrival; a message may be older than one that came before it.

        Returns:
            Commands for all robots of the team, in the order of their ids, within what the wheels can do.
        """
        ...
