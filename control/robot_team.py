"""The robots' minds, all at once: each follows what it heard, and nothing else."""

from dataclasses import dataclass

import numpy as np

from skyherd.control.avoidance.neighbor_memory import NeighborMemory
from skyherd.control.avoidance.speed_bound import AvoidanceRule, avoiding_law
from skyherd.control.robots.goal_fusion import GoalInboxes
from skyherd.control.robots.unicycle import RobotLaw, Wheels, robot_commands
from skyherd.geometry import BoolArray, IntArray
from skyherd.messages import MotionGoals, Proximity, VelocityCommand


@dataclass
class Team:
    """The robots: what they have heard, and the law that they follow.

    Attributes:
        inboxes: goals heard from units.
        gains: of the robots' law.
        wheels: what the robots can do.
        around: bodies heard of; None where robots are points.
        rule: how robots keep apart; None where they do not.
    """

    inboxes: GoalInboxes
    gains: RobotLaw
    wheels: Wheels
    around: NeighborMemory | None = None
    rule: AvoidanceRule | None = None

    def receive(self, message: MotionGoals | Proximity, time_s: float, heard: BoolArray) -> None:
        """Take in a unit's message that arrives now at those of its robots that `heard` (N,) it."""
        if isinstance(message, MotionGoals):
            self.inboxes.receive(message, time_s, heard)
        elif self.around is not None:
            self.around.receive(message, heard)

    def command(self, time_s: float) -> VelocityCommand:
        """What all robots do from now on until the next command."""
        if self.around is None or self.rule is None:
            return robot_commands(self.inboxes, self.gains, time_s, wheels=self.wheels)
        rho = self.gains.follow(self.inboxes, time_s)
        v_mps, omega_radps = avoiding_law(rho, self.gains, memory=self.around, rule=self.rule, time_s=time_s)
        self.around.record_rotation(omega_radps, time_s, self.rule.step_s)
        return VelocityCommand(self.inboxes.ids, v_mps, omega_radps)

    def commanded_ids(self, time_s: float) -> IntArray:
        """Robots that follow a goal heard of late."""
        return np.asarray(self.inboxes.ids[self.inboxes.fresh(time_s).any(axis=0)])
