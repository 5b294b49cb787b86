"""Robots that follow a law from the literature: told the truth, they hear nothing of the units."""

import numpy as np

from skyherd.control.robots.unicycle import RobotLaw, Wheels, wheel_law
from skyherd.geometry import BoolArray, IntArray, to_complex
from skyherd.messages import MotionGoals, Proximity, VelocityCommand
from skyherd.sim.baseline_laws import Law
from skyherd.sim.world import World


class OracleTeam:
    """In the place of `control.Team`: the same wheels, and the same way from a wanted velocity to speeds.

    Args:
        world: the truth.
        law: wanted velocities of all robots.
        gains: of the robots; one that faces the right way drives as fast as the law wants.
        wheels: what the robots can do.
    """

    def __init__(self, world: World, law: Law, gains: RobotLaw, wheels: Wheels) -> None:
        self._world, self._law, self._gains, self._wheels = world, law, gains, wheels

    def receive(self, message: MotionGoals | Proximity, time_s: float, heard: BoolArray) -> None:
        """Nothing: what units say does not matter."""

    def command(self, time_s: float) -> VelocityCommand:
        """What all robots do from now on until the next command."""
        world = self._world
        wanted_mps = self._law(to_complex(world.positions_m)) * np.exp(-1j * world.headings_rad)
        speed_mps = float(self._gains.speed_mps(np.ones(1))[0])
        v_mps, omega_radps = wheel_law(wanted_mps / speed_mps, self._gains, self._wheels)
        return VelocityCommand(world.ids, v_mps, omega_radps)

    def commanded_ids(self, time_s: float) -> IntArray:
        """All robots."""
        return self._world.ids
