"""What a unit's camera gives, and the interface of what makes it of the world."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from skyherd.geometry import Image, IntArray
from skyherd.messages import Detections
from skyherd.sim.world import World


@dataclass(frozen=True)
class Sight:
    """What one unit's camera gave, and the truth that recall is judged by.

    Attributes:
        detections: for the controller.
        whole_ids: robots and obstacles whose whole marker card is in the image.
        found_ids: those of them that were detected.
        false_detections: detections of neither robot nor obstacle, or farther than half a side from theirs.
        image: the grey picture, if one was made.
    """

    detections: Detections
    whole_ids: IntArray
    found_ids: IntArray
    false_detections: int
    image: Image | None


class Perception(Protocol):
    """From the world to what the units detect: by rendering and detecting, by projection, or otherwise.

    It is the one place in the loop where the truth turns into detections, so it alone may read `world`; what
    it puts into `Sight.detections` is all that the controllers get.
    """

    def look(self, world: World, units: Sequence[int], time_s: float) -> Iterable[Sight]:
        """What each of the given units sees now.

        Args:
            world: the truth: `world.cameras[unit]`, `world.camera_pose(unit)` and `world.markers`.
            units: those that take an image now, ascending; dead units and lost frames are not among them.
            time_s: now; called once a step, in the order of time, also with no units at all.

        Returns:
            One `Sight` for each unit, in the order of `units`: a list, or an iterator, in which case units
            decide while images of others are still being made. Its detections carry that unit's id and this
            time. The same calls after the same construction must give the same result: random numbers come
            from a generator that is passed to the constructor.
        """
        ...
