"""Robots that follow a law from the literature, which needs more than the units' images tell.

The laws of `skyherd.sim.baseline_laws` read true positions from the world. They stand in the robots' place
outside `skyherd.control`, so that the rule that control knows nothing of the truth holds for it without
exception; wheels and limits are the same, so that `skyherd study methods` can compare the laws.
"""

import numpy as np

from skyherd.control.robots.unicycle import RobotLaw, Wheels, wheel_law
from skyherd.geometry import BoolArray, IntArray, to_complex
from skyherd.messages import MotionGoals, Proximity, VelocityCommand
from skyherd.sim.baseline_laws import Law
from skyherd.sim.world import World


class OracleTeam:
    """Takes the place of `skyherd.control.Team`: the same wheels, driven by a law that knows the truth.

    Args:
        world: the truth.
        law: preferred velocities of all robots.
        gains: robot law whose gains are used; a robot that faces along its preferred velocity drives at it.
        wheels: limits of the robots' speeds.
    """

    def __init__(self, world: World, law: Law, gains: RobotLaw, wheels: Wheels) -> None:
        self._world, self._law, self._gains, self._wheels = world, law, gains, wheels

    def receive(self, message: MotionGoals | Proximity, time_s: float, received: BoolArray) -> None:
        """Ignore a message from a unit: the law does not use it."""

    def command(self, time_s: float) -> VelocityCommand:
        """Commands of all robots at `time_s`, for the true positions and headings."""
        world = self._world
        preferred_mps = self._law(to_complex(world.positions_m)) * np.exp(-1j * world.headings_rad)
        gain_mps = float(self._gains.speed_mps(np.ones(1))[0])
        v_mps, omega_radps = wheel_law(preferred_mps / gain_mps, self._gains, self._wheels)
        return VelocityCommand(world.ids, v_mps, omega_radps)

    def commanded_ids(self, time_s: float) -> IntArray:
        """All robots: each has a velocity to follow at any time."""
        return self._world.ids
