"""The robots' own computers, all at once: each follows the goals that it received, and nothing else."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control.avoidance.neighbor_memory import NeighborMemory
from skyherd.control.avoidance.speed_bound import AvoidanceRule, avoiding_law
from skyherd.control.policy import Delivery, RobotTeam, TeamOrders
from skyherd.control.robots.goal_fusion import GoalInboxes
from skyherd.control.robots.latency_compensation import LatencyCompensation
from skyherd.control.robots.unicycle import RobotLaw, Wheels, robot_commands
from skyherd.control.team_clock import TeamClock
from skyherd.geometry import Array, IntArray
from skyherd.messages import MotionGoals, VelocityCommand, among


@dataclass
class RobotClocks:
    """The robots' own clocks, and what each has learned of the team's time from what it received.

    Attributes:
        read: what the robots' clocks (N,) show when the team's computer shows a time.
        team: how they learn.
    """

    read: Callable[[float], Array]
    team: TeamClock

    def hear(self, delivery: Delivery, ids: IntArray, time_s: float) -> None:
        """Take in the stamp of a message that arrives now at some of the robots `ids` (N,)."""
        heard = among(ids, delivery.message.ids[delivery.received])
        self.team.hear(delivery.message.time_s, self.read(time_s), np.flatnonzero(heard))

    def lead_s(self, time_s: float) -> Array:
        """The team's time, as each robot (N,) knows it now, less `time_s`."""
        return self.team.time_s(self.read(time_s)) - time_s


@dataclass
class GoalFollowers(RobotTeam):
    """Robots that fuse the goals of all units that control them (eq. 4) and drive there (eq. 7-8).

    Attributes:
        inboxes: goals received, by unit and robot.
        gains: of the robots' law.
        wheels: what the robots' wheels can do.
        neighbors: bodies near each robot, as units reported them; None where robots are points.
        avoidance: how robots keep apart from these; None where they do not.
        latency_compensation: what each robot has driven since, which it takes off goals of images in the past; None where
            goals are followed as they come.
        clocks: how robots tell the age of messages though their clocks differ; None where all clocks agree.
    """

    inboxes: GoalInboxes
    gains: RobotLaw
    wheels: Wheels
    neighbors: NeighborMemory | None = None
    avoidance: AvoidanceRule | None = None
    latency_compensation: LatencyCompensation | None = None
    clocks: RobotClocks | None = None

    def decide(self, time_s: float, delivered: Sequence[Delivery]) -> TeamOrders:
        """Take in the messages; then steer by all goals that are not too old."""
        for delivery in delivered:
            if self.clocks is not None:
                self.clocks.hear(delivery, self.inboxes.ids, time_s)
        lead_s = np.zeros(self.inboxes.ids.size) if self.clocks is None else self.clocks.lead_s(time_s)
        for delivery in delivered:
            if isinstance(delivery.message, MotionGoals):
                self.inboxes.receive(delivery.message, time_s, delivery.received)
            elif self.neighbors is not None:
                self.neighbors.receive(delivery.message, delivery.received, lead_s)
        commanded = self.inboxes.ids[self.inboxes.fresh(time_s).any(axis=0)]
        inboxes = self.inboxes
        if self.latency_compensation is not None:
            inboxes = self.latency_compensation.compensate(inboxes, time_s, lead_s)
        command = self._command(inboxes, time_s, lead_s)
        if self.latency_compensation is not None:
            self.latency_compensation.record(command, time_s)
        return TeamOrders(command, np.asarray(commanded))

    def _command(self, inboxes: GoalInboxes, time_s: float, lead_s: Array) -> VelocityCommand:
        if self.neighbors is None or self.avoidance is None:
            return robot_commands(inboxes, self.gains, time_s, wheels=self.wheels)
        rho = self.gains.follow(inboxes, time_s)
        v_mps, omega_radps = avoiding_law(
            rho, self.gains, memory=self.neighbors, rule=self.avoidance, time_s=time_s + lead_s
        )
        self.neighbors.record_rotation(omega_radps, time_s, self.avoidance.step_s)
        return VelocityCommand(inboxes.ids, v_mps, omega_radps)
