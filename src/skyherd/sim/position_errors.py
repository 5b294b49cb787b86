"""Errors of the positions that the units see, as large as those that other laws are told."""

from collections.abc import Iterable, Sequence
from copy import copy

import numpy as np

from skyherd.datasets import Mission
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.sim.sight import Perception, Sight
from skyherd.sim.world import World


class ErroneousPositions(Perception):
    """Perception of robots whose positions have an error, drawn for all images of one instant.

    The covariances of the detections do not contain it.

    Args:
        perception: perception of the scenario.
        noise_m: standard deviation of the error along x and along y.
        rng: generator of the errors.
    """

    def __init__(self, perception: Perception, noise_m: float, rng: np.random.Generator) -> None:
        self._perception, self._noise_m, self._rng = perception, noise_m, rng

    def look(self, world: World, units: Sequence[int], time_s: float) -> Iterable[Sight]:
        """Return the output of each unit's camera for the erroneous positions."""
        shown = copy(world)
        shown.positions_m = world.positions_m + self._rng.normal(
            scale=self._noise_m, size=world.positions_m.shape
        )
        return self._perception.look(shown, units, time_s)


def with_position_errors(perception: Perception, mission: Mission) -> Perception:
    """Return the perception with the errors of `control.told_noise_m`, for robots that follow units."""
    control = mission.scenario.control
    if control.method != "similarity" or not control.told_noise_m:
        return perception
    rng = generator(mission.scenario.seed, RunStream.REPORTED_POSITIONS)
    return ErroneousPositions(perception, control.told_noise_m, rng)
