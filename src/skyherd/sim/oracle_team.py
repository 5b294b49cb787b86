"""Robots with a law from the literature, which needs more data than the units' images provide.

The laws of `skyherd.sim.baseline_laws` read true positions from the world. They are outside
`skyherd.control`, so that control never has access to the truth. Wheels and limits are the same, so that
`skyherd study methods` can compare the laws.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control import Delivery, RobotLaw, RobotTeam, TeamOrders, Wheels, wheel_law
from skyherd.errors import InputError
from skyherd.geometry import ComplexArray, to_complex
from skyherd.messages import TIME_TOLERANCE_S, VelocityCommand
from skyherd.sim.baseline_laws import Law
from skyherd.sim.world import World


@dataclass(frozen=True)
class News:
    """Quality of the positions that the robots receive, once per step.

    Attributes:
        noise_m: standard deviation of the error of each position, along x and along y.
        loss: share of the steps in which a robot receives nothing, drawn for each robot.
        lifetime_s: maximum time for which a robot repeats its last command without a new position.
        rng: generator of both.
    """

    noise_m: float
    loss: float
    lifetime_s: float
    rng: np.random.Generator


class OracleTeam(RobotTeam):
    """Team that uses a law instead of `skyherd.control.GoalFollowers`, with the same wheels and wheel law.

    Args:
        world: ground truth, read at each step.
        law: desired velocities of all robots on the ground, m/s, from their positions.
        gains: gains of the robots. A robot that faces its desired velocity drives at that speed.
        wheels: kinematics and limits of the robots.
        news: noise and loss of the positions.
    """

    def __init__(self, world: World, law: Law, gains: RobotLaw, wheels: Wheels, news: News) -> None:
        self._world, self._law, self._gains, self._wheels, self._news = world, law, gains, wheels, news
        self._v_mps, self._omega_radps = np.zeros((2, world.ids.size))
        self._told_s = np.full(world.ids.size, -np.inf)

    def decide(self, time_s: float, delivered: Sequence[Delivery]) -> TeamOrders:
        """Return the orders of all robots by the law, at the positions that they receive from the world.

        Raises:
            InputError: the law does not return a finite velocity for each robot.
        """
        world, news = self._world, self._news
        wanted_mps = self._velocities(self._told_positions()) * np.exp(-1j * world.headings_rad)
        speed_mps = float(self._gains.speed_mps(np.ones(1))[0])
        v_mps, omega_radps = wheel_law(wanted_mps / speed_mps, self._gains, self._wheels)
        told = np.ones(world.ids.size, dtype=bool)
        if news.loss:
            told = news.rng.random(world.ids.size) >= news.loss
        self._told_s[told] = time_s
        fresh = self._told_s >= time_s - news.lifetime_s - TIME_TOLERANCE_S
        self._v_mps = np.where(told, v_mps, self._v_mps) * fresh
        self._omega_radps = np.where(told, omega_radps, self._omega_radps) * fresh
        return TeamOrders(VelocityCommand(world.ids, self._v_mps, self._omega_radps), world.ids[fresh])

    def _told_positions(self) -> ComplexArray:
        positions_m = to_complex(self._world.positions_m)
        if not self._news.noise_m:
            return positions_m
        error_m = self._news.rng.normal(scale=self._news.noise_m, size=(2, positions_m.size))
        return np.asarray(positions_m + error_m[0] + 1j * error_m[1])

    def _velocities(self, positions_m: ComplexArray) -> ComplexArray:
        velocities = np.asarray(self._law(positions_m))
        if velocities.shape != positions_m.shape or not np.isfinite(velocities).all():
            what = f"gave {velocities.size} velocities for {positions_m.size} robots, or no finite ones"
            raise InputError("control.method", what, "a law with a finite complex velocity for each robot")
        return velocities
