"""Robots with a law from the literature, which needs more data than the units' images provide.

The laws of `skyherd.sim.baseline_laws` read true positions from the world. They are outside
`skyherd.control`, so that control never has access to the truth. Wheels, limits and collision avoidance are
the same, so that `skyherd study methods` can compare the laws.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control import (
    AvoidanceRule,
    BodyRule,
    Delivery,
    NeighborMemory,
    RobotLaw,
    RobotTeam,
    TeamOrders,
    Wheels,
    avoiding_law,
    best_assignment,
    proximity,
    wheel_law,
)
from skyherd.errors import InputError
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, to_complex, to_points
from skyherd.messages import TIME_TOLERANCE_S, Detections, VelocityCommand
from skyherd.sim.baseline_laws import Law
from skyherd.sim.world import World

START_ROTATIONS = 24
"""Start rotations of the first search for the roles that robots have taken. Chosen: as in `RoleRule`."""


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


@dataclass(frozen=True)
class Received:
    """Positions that the robots receive at one time.

    Attributes:
        positions_m: (N,) positions, with their errors.
        told: (N,) robots that receive them now.
        fresh: (N,) robots whose last positions are not stale.
        time_s: the time.
    """

    positions_m: ComplexArray
    told: BoolArray
    fresh: BoolArray
    time_s: float


class Avoidance:
    """Collision avoidance of `skyherd.control`, with bodies from the positions that the robots receive.

    Args:
        world: ground truth, for headings and obstacles.
        bodies: sizes of the bodies.
        rule: the robots' own parameters.
    """

    def __init__(self, world: World, bodies: BodyRule, rule: AvoidanceRule) -> None:
        self._world, self._bodies, self._rule = world, bodies, rule
        speed_sides_ps = rule.wheels.max_speed_mps / rule.side_m
        self._memory = NeighborMemory(
            world.ids, np.unique(world.markers.ids), rule.lifetime_s, max_speed_sides_ps=speed_sides_ps
        )

    def command(self, rho: ComplexArray, gains: RobotLaw, received: "Received") -> tuple[Array, Array]:
        """Return collision-free speeds v (N,), m/s, and ω (N,), rad/s, of robots that follow vectors rho."""
        seen = self._overhead(received.positions_m, received.time_s)
        message = proximity(seen, self._world.ids, self._bodies)
        self._memory.receive(message, np.isin(message.ids, self._world.ids[received.told]))
        v_mps, omega_radps = avoiding_law(
            rho,
            gains,
            memory=self._memory,
            rule=self._rule,
            time_s=received.time_s,
            driven=received.fresh,
        )
        v_mps, omega_radps = v_mps * received.fresh, omega_radps * received.fresh
        self._memory.record_rotation(omega_radps, received.time_s, self._rule.step_s)
        return v_mps, omega_radps

    def _overhead(self, positions_m: ComplexArray, time_s: float) -> Detections:
        """Return the bodies as an ideal camera sees them from above, with a pixel per metre and v to -y."""
        markers, count = self._world.markers, positions_m.size
        centers = to_points(np.concatenate([positions_m, to_complex(markers.positions_m[count:])]).conj())
        return Detections(
            unit_id=0,
            time_s=time_s,
            image_size_px=np.ones(2, dtype=np.int64),
            ids=markers.ids,
            centers_px=centers,
            headings_rad=-markers.headings_rad,
            sides_px=np.full(markers.ids.size, self._rule.side_m),
            corners_px=np.repeat(centers[:, None], 4, axis=1),
            covariances=np.zeros((markers.ids.size, 3, 3)),
        )


class OracleTeam(RobotTeam):
    """Team that uses a law instead of `skyherd.control.GoalFollowers`, with the same wheels and wheel law.

    Args:
        world: ground truth, read at each step.
        law: desired velocities of all robots on the ground, m/s, from their positions.
        gains: gains of the robots. A robot that faces its desired velocity drives at that speed.
        wheels: kinematics and limits of the robots.
        news: noise and loss of the positions.
        avoidance: collision avoidance; None without.
        lead: function from a time, s, to a law whose velocities move the shape; None if it rests.
        free_shape: (N,) shape, if the law has no roles. The team then reports which robot has taken which
            point of it.
    """

    def __init__(
        self,
        world: World,
        law: Law,
        gains: RobotLaw,
        wheels: Wheels,
        news: News,
        *,
        avoidance: Avoidance | None = None,
        lead: Callable[[float], Law] | None = None,
        free_shape: ComplexArray | None = None,
    ) -> None:
        self._world, self._law, self._gains, self._wheels, self._news = world, law, gains, wheels, news
        self._avoidance, self._lead, self._free_shape = avoidance, lead, free_shape
        self._roles: IntArray | None = None
        self._v_mps, self._omega_radps = np.zeros((2, world.ids.size))
        self._wanted_mps: ComplexArray = np.zeros(world.ids.size, dtype=np.complex128)
        self._told_s = np.full(world.ids.size, -np.inf)

    def decide(self, time_s: float, delivered: Sequence[Delivery]) -> TeamOrders:
        """Return the orders of all robots by the law, at the positions that they receive from the world.

        Raises:
            InputError: the law does not return a finite velocity for each robot.
        """
        world, news, positions_m = self._world, self._news, self._told_positions()
        told = np.ones(world.ids.size, dtype=bool)
        if news.loss:
            told = news.rng.random(world.ids.size) >= news.loss
        self._told_s[told] = time_s
        fresh = self._told_s >= time_s - news.lifetime_s - TIME_TOLERANCE_S
        self._wanted_mps = np.where(told, self._velocities(positions_m, time_s), self._wanted_mps) * fresh
        rho = self._wanted_mps * np.exp(-1j * world.headings_rad)
        rho /= float(self._gains.speed_mps(np.ones(1))[0])
        if self._avoidance is None:
            v_mps, omega_radps = wheel_law(rho, self._gains, self._wheels)
            self._v_mps = np.where(told, v_mps, self._v_mps) * fresh
            self._omega_radps = np.where(told, omega_radps, self._omega_radps) * fresh
        else:
            received = Received(positions_m, told, fresh, time_s)
            self._v_mps, self._omega_radps = self._avoidance.command(rho, self._gains, received)
        command = VelocityCommand(world.ids, self._v_mps, self._omega_radps)
        return TeamOrders(command, world.ids[fresh], self._taken_roles())

    def _taken_roles(self) -> IntArray | None:
        """Return the template row (N,) of each robot, by the true positions; None for fixed roles."""
        if self._free_shape is None:
            return None
        places_m, first = to_complex(self._world.positions_m), self._roles is None
        roles = np.arange(places_m.size) if self._roles is None else self._roles
        alike = np.zeros(places_m.size, dtype=np.int64)
        starts = START_ROTATIONS if first else 0
        self._roles = roles[best_assignment(places_m, self._free_shape[roles], alike, starts=starts)]
        return self._roles

    def _told_positions(self) -> ComplexArray:
        positions_m = to_complex(self._world.positions_m)
        if not self._news.noise_m:
            return positions_m
        error_m = self._news.rng.normal(scale=self._news.noise_m, size=(2, positions_m.size))
        return np.asarray(positions_m + error_m[0] + 1j * error_m[1])

    def _velocities(self, positions_m: ComplexArray, time_s: float) -> ComplexArray:
        velocities = np.asarray(self._law(positions_m))
        if self._lead is not None:
            velocities = velocities + self._lead(time_s)(positions_m)
        if velocities.shape != positions_m.shape or not np.isfinite(velocities).all():
            what = f"gave {velocities.size} velocities for {positions_m.size} robots, or no finite ones"
            raise InputError("control.method", what, "a law with a finite complex velocity for each robot")
        return velocities
