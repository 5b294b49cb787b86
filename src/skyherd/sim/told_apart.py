"""Perception that tells robots apart from copies of their markers, by motion."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from skyherd.control import Copies
from skyherd.datasets import Mission
from skyherd.sim.sight import Perception, Sight
from skyherd.sim.world import World


class RobotsToldApart(Perception):
    """Perception that lists copies of a robot's marker under other ids, once the robot is told apart.

    Args:
        perception: perception of the scenario.
    """

    def __init__(self, perception: Perception) -> None:
        self._perception, self._copies = perception, defaultdict[int, Copies](Copies)

    def look(self, world: World, units: Sequence[int], time_s: float) -> Iterable[Sight]:
        """Return the output of each unit's camera; see `Perception.look`."""
        return self._relabelled(units, self._perception.look(world, units, time_s))

    def _relabelled(self, units: Sequence[int], sights: Iterable[Sight]) -> Iterator[Sight]:
        for unit, sight in zip(units, sights, strict=True):
            relabelled = self._copies[unit].relabel(sight.detections)
            yield sight if relabelled is sight.detections else replace(sight, detections=relabelled)


def with_robots_told_apart(perception: Perception, mission: Mission) -> Perception:
    """Return a perception that tells robots apart by motion; the same one if the scenario disables it."""
    return RobotsToldApart(perception) if mission.scenario.control.tell_apart else perception
