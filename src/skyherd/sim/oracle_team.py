"""Robots that follow a law from the literature, which needs more than the units' images tell.

The laws of `skyherd.sim.baseline_laws` read true positions from the world. They stand in the robots' place
outside `skyherd.control`, so that the rule that control knows nothing of the truth holds for it without
exception; wheels and limits are the same, so that `skyherd study methods` can compare the laws.
"""

from collections.abc import Sequence

import numpy as np

from skyherd.control import Delivery, RobotLaw, RobotTeam, TeamOrders, Wheels, wheel_law
from skyherd.geometry import to_complex
from skyherd.messages import VelocityCommand
from skyherd.sim.baseline_laws import Law
from skyherd.sim.world import World


class OracleTeam(RobotTeam):
    """In the place of `skyherd.control.GoalFollowers`, with the same wheels and the same way to speeds.

    Args:
        world: the truth, read at each step.
        law: wanted velocities of all robots on the ground, m/s, from their positions.
        gains: of the robots; one that faces the right way drives as fast as the law wants.
        wheels: what the robots can do.
    """

    def __init__(self, world: World, law: Law, gains: RobotLaw, wheels: Wheels) -> None:
        self._world, self._law, self._gains, self._wheels = world, law, gains, wheels

    def decide(self, time_s: float, delivered: Sequence[Delivery]) -> TeamOrders:
        """What all robots do by the law, at the places where the world has them."""
        world = self._world
        wanted_mps = self._law(to_complex(world.positions_m)) * np.exp(-1j * world.headings_rad)
        speed_mps = float(self._gains.speed_mps(np.ones(1))[0])
        v_mps, omega_radps = wheel_law(wanted_mps / speed_mps, self._gains, self._wheels)
        return TeamOrders(VelocityCommand(world.ids, v_mps, omega_radps), world.ids)
