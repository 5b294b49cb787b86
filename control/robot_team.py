"""The on-board computers of all robots: each follows the goals that it received, and nothing else."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control.avoidance.avoiding_law import avoiding_law
from skyherd.control.avoidance.neighbor_memory import NeighborMemory
from skyherd.control.avoidance.speed_bound import AvoidanceRule
from skyherd.control.policy import Delivery, RobotTeam, TeamOrders
from skyherd.control.robots.goal_fusion import GoalInboxes
from skyherd.control.robots.latency_compensation import LatencyCompensation
from skyherd.control.robots.unicycle import RobotLaw, Wheels, finite_command, robot_commands
from skyherd.control.team_clock import TeamClock
from skyherd.geometry import Array, IntArray
from skyherd.messages import MotionGoals, VelocityCommand, among


@dataclass
class RobotClocks:
    """The robots' own clocks, and their estimate of the team's time from received messages.

    Attributes:
        read: function from the team computer's time to the readings (N,) of the robots' clocks.
        team: estimator of the team's time.
    """

    read: Callable[[float], Array]
    team: TeamClock

    def hear(self, delivery: Delivery, ids: IntArray, time_s: float) -> None:
        """Update the clocks of the robots among `ids` (N,) that receive a message at `time_s`."""
        heard = among(ids, delivery.message.ids[delivery.received])
        self.team.hear(delivery.message.time_s, self.read(time_s), np.flatnonzero(heard))

    def lead_s(self, time_s: float) -> Array:
        """Return the team's time, as each robot (N,) estimates it now, minus `time_s`."""
        return self.team.time_s(self.read(time_s)) - time_s


@dataclass
class GoalFollowers(RobotTeam):
    """Robots that fuse the goals of all units that control them (eq. 4) and follow them (eq. 7-8).

    Attributes:
        inboxes: received goals, by unit and robot; their lifetime is the watchdog timeout of the robots.
        gains: gains of the robots' law.
        wheels: limits of the robots' wheels.
        neighbors: bodies near each robot, as reported by units; None if robots are points.
        avoidance: settings of collision avoidance; None without avoidance.
        latency_compensation: subtracts each robot's own motion since the image from its goals; None without
            latency compensation.
        clocks: estimate message ages although clocks differ; None if all clocks agree.
    """

    inboxes: GoalInboxes
    gains: RobotLaw
    wheels: Wheels
    neighbors: NeighborMemory | None = None
    avoidance: AvoidanceRule | None = None
    latency_compensation: LatencyCompensation | None = None
    clocks: RobotClocks | None = None

    def decide(self, time_s: float, delivered: Sequence[Delivery]) -> TeamOrders:
        """Receive the messages, then steer by all goals that are not stale."""
        for delivery in delivered:
            if self.clocks is not None:
                self.clocks.hear(delivery, self.inboxes.ids, time_s)
        lead_s = self.lead_s(time_s)
        for delivery in delivered:
            if isinstance(delivery.message, MotionGoals):
                self.inboxes.receive(delivery.message, time_s, delivery.received)
            elif self.neighbors is not None:
                self.neighbors.receive(delivery.message, delivery.received, lead_s)
        commanded = self.inboxes.ids[self.inboxes.fresh(time_s).any(axis=0)]
        command = self._command(self.present_inboxes(time_s), time_s, lead_s)
        self.record(command, time_s)
        return TeamOrders(command, np.asarray(commanded))

    def lead_s(self, time_s: float) -> Array:
        """Return the team's time, as each robot (N,) estimates it, minus `time_s`; 0 if all clocks agree."""
        return np.zeros(self.inboxes.ids.size) if self.clocks is None else self.clocks.lead_s(time_s)

    def present_inboxes(self, time_s: float) -> GoalInboxes:
        """Return the goals in the robots' frames at `time_s`, the time of the last decision."""
        if self.latency_compensation is None:
            return self.inboxes
        return self.latency_compensation.compensate(self.inboxes, time_s, self.lead_s(time_s))

    def record(self, command: VelocityCommand, time_s: float) -> None:
        """Record the command that the wheels obey from the decision at `time_s` on.

        `decide` records its own. If the wheels obey another one, a further call at this time replaces it.
        """
        if self.latency_compensation is not None:
            self.latency_compensation.record(command, time_s)
        if self.neighbors is not None and self.avoidance is not None:
            self.neighbors.record_rotation(command.omega_radps, time_s, self.avoidance.step_s)

    def _command(self, inboxes: GoalInboxes, time_s: float, lead_s: Array) -> VelocityCommand:
        if self.neighbors is None or self.avoidance is None:
            return robot_commands(inboxes, self.gains, time_s, wheels=self.wheels)
        rho = self.gains.follow(inboxes, time_s)
        v_mps, omega_radps = avoiding_law(
            rho,
            self.gains,
            memory=self.neighbors,
            rule=self.avoidance,
            time_s=time_s + lead_s,
            driven=np.asarray(inboxes.fresh(time_s).any(axis=0)),
        )
        return finite_command(inboxes.ids, v_mps, omega_radps)
