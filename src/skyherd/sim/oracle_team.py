"""Robots that follow a law from the literature, which needs more than the units' images tell.

The laws of `skyherd.sim.baseline_laws` read true positions from the world. They stand in the robots' place
outside `skyherd.control`, so that the rule that control knows nothing of the truth holds for it without
exception; wheels and limits are the same, so that `skyherd study methods` can compare the laws.
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
    """How well the robots are told where they are, once a step.

    Attributes:
        noise_m: standard deviation of the error of each position, along x and along y.
        loss: share of the steps at which a robot is told nothing, drawn for each robot.
        lifetime_s: a robot that is told nothing drives on as it did, for at most this long.
        rng: what draws both.
    """

    noise_m: float
    loss: float
    lifetime_s: float
    rng: np.random.Generator


class OracleTeam(RobotTeam):
    """In the place of `skyherd.control.GoalFollowers`, with the same wheels and the same way to speeds.

    Args:
        world: the truth, read at each step.
        law: wanted velocities of all robots on the ground, m/s, from their positions.
        gains: of the robots; one that faces the right way drives as fast as the law wants.
        wheels: what the robots can do.
        news: what is lost of the truth on its way to the robots.
    """

    def __init__(self, world: World, law: Law, gains: RobotLaw, wheels: Wheels, news: News) -> None:
        self._world, self._law, self._gains, self._wheels, self._news = world, law, gains, wheels, news
        self._v_mps, self._omega_radps = np.zeros((2, world.ids.size))
        self._told_s = np.full(world.ids.size, -np.inf)

    def decide(self, time_s: float, delivered: Sequence[Delivery]) -> TeamOrders:
        """What all robots do by the law, at the places where they are told that the world has them.

        Raises:
            InputError: the law gives no velocity for each robot.
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
