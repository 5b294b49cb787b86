"""Perception of robots with several markers: detections of markers become detections of robots."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from skyherd.datasets import Mission
from skyherd.markers.layout import MarkerLayout
from skyherd.messages import among
from skyherd.sim.sight import Perception, Sight
from skyherd.sim.world import World
from skyherd.vision import fuse_markers


class FusedMarkers(Perception):
    """Perception that fuses the markers of each robot.

    A robot counts as whole in an image if one of its markers does, and as found if one of these was found.

    Args:
        perception: perception of the markers.
        layout: the markers on the robots.
        dictionary: dictionary of the markers.
    """

    def __init__(self, perception: Perception, layout: MarkerLayout, dictionary: str) -> None:
        self._perception, self._layout, self._dictionary = perception, layout, dictionary

    def look(self, world: World, units: Sequence[int], time_s: float) -> Iterable[Sight]:
        """Return the output of each unit's camera; see `Perception.look`."""
        return self._fused(self._perception.look(world, units, time_s))

    def _fused(self, sights: Iterable[Sight]) -> Iterator[Sight]:
        for sight in sights:
            detections = fuse_markers(sight.detections, self._layout, sight.image, self._dictionary)
            found_ids = np.unique(self._layout.robots_of(sight.found_ids))
            yield replace(
                sight,
                detections=detections,
                whole_ids=np.unique(self._layout.robots_of(sight.whole_ids)),
                found_ids=found_ids[among(found_ids, detections.ids)],
            )


def with_fused_markers(perception: Perception, mission: Mission) -> Perception:
    """Return a perception of the robots of a mission; the same one if each has one marker."""
    if mission.layout is None:
        return perception
    return FusedMarkers(perception, mission.layout, mission.scenario.marker.dictionary)
