"""Schedule: the shape that the team must form, and its motion, at each of the team's times."""

from dataclasses import dataclass
from itertools import pairwise

from skyherd.control.formation.motion import REST, ShapeMotion
from skyherd.control.formation.template import Template
from skyherd.errors import InputError
from skyherd.messages import TIME_TOLERANCE_S


@dataclass(frozen=True)
class Schedule:
    """Sequence of shapes: a first one, and later ones that each replace the one before.

    All units have the same schedule and the same clock. A change therefore needs no agreement.

    Attributes:
        first: the shape from the start.
        later: pairs (time, s, shape), times positive and ascending; all shapes have the same robots.
        motions: pairs (time, s, motion), times not negative and ascending; the shape rests before the first.

    Raises:
        InputError: the times of shapes do not ascend from above 0, or those of motions from 0; or a later
            shape has other robots.
    """

    first: Template
    later: tuple[tuple[float, Template], ...] = ()
    motions: tuple[tuple[float, ShapeMotion], ...] = ()

    def __post_init__(self) -> None:
        times = [0.0, *(time_s for time_s, _ in self.later)]
        if any(before >= after for before, after in pairwise(times)):
            raise InputError("template.then", f"times {times[1:]} s", "times after 0 that ascend")
        times = [time_s for time_s, _ in self.motions]
        if any(time_s < 0 for time_s in times) or any(before >= after for before, after in pairwise(times)):
            raise InputError("template.motion", f"times {times} s", "times from 0 that ascend")
        if any(shape.ids.tolist() != self.first.ids.tolist() for _, shape in self.later):
            raise InputError("template.then", "another team", "a point for each robot of the first shape")

    def at(self, time_s: float) -> Template:
        """Return the shape at a time; it is the given object, so that a change is detected by identity."""
        begun = [shape for at_s, shape in self.later if at_s <= time_s + TIME_TOLERANCE_S]
        return begun[-1] if begun else self.first

    def motion_at(self, time_s: float) -> ShapeMotion:
        """Return the motion of the shape at a time."""
        begun = [motion for at_s, motion in self.motions if at_s <= time_s + TIME_TOLERANCE_S]
        return begun[-1] if begun else REST
