"""Output of a unit's camera, and the interface of perceptions, which make it from the world."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from skyherd.geometry import Image, IntArray
from skyherd.messages import Detections
from skyherd.messages.short_repr import short_repr
from skyherd.sim.world import World


@dataclass(frozen=True)
class Sight:
    """Output of one unit's camera, with the ground truth for recall.

    Attributes:
        detections: detections for the controller.
        whole_ids: robots and obstacles whose whole marker card is in the image.
        found_ids: those of them that were detected.
        false_detections: number of detections without a robot or obstacle within half a side.
        image: the grey picture, or None if none was made.
    """

    detections: Detections
    whole_ids: IntArray
    found_ids: IntArray
    false_detections: int
    image: Image | None

    __repr__ = short_repr


class Perception(Protocol):
    """Interface from the world to the units' detections, by rendering, projection or other methods.

    Only perceptions convert ground truth into detections, so only they may read `world`. Controllers receive
    nothing else than `Sight.detections`.
    """

    def look(self, world: World, units: Sequence[int], time_s: float) -> Iterable[Sight]:
        """Return the output of each given unit's camera now.

        Args:
            world: ground truth: `world.cameras[unit]`, `world.camera_pose(unit)`, `world.markers`,
                `world.covered_ids` and `world.imaging[unit]`.
            units: units that take an image now, ascending, without dead units and lost frames.
            time_s: the time now. The method is called once per step, in the order of time, also without
                units.

        Returns:
            One `Sight` per unit, in the order of `units`, as a list or an iterator. With an iterator, units
            decide while other images are still processed. Detections carry the unit's id and this time. The
            same calls after the same construction must give the same result. Random numbers must come from a
            generator that is an argument of the constructor.
        """
        ...
