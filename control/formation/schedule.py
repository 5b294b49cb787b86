"""Shapes one after the other: what a team forms from when on."""

from dataclasses import dataclass
from itertools import pairwise

from skyherd.control.formation.template import Template
from skyherd.errors import InputError


@dataclass(frozen=True)
class Schedule:
    """A first shape, and later ones by the common clock.

    Attributes:
        first: holds from the start.
        later: (time, s, shape), ascending; all of the same robots.
    """

    first: Template
    later: tuple[tuple[float, Template], ...] = ()

    def __post_init__(self) -> None:
        times = [0.0, *(time_s for time_s, _ in self.later)]
        if any(before >= after for before, after in pairwise(times)):
            raise InputError("template.then", f"times {times[1:]} s", "times after 0 that ascend")
        if any(shape.ids.tolist() != self.first.ids.tolist() for _, shape in self.later):
            raise InputError("template.then", "another team", "a point for each robot of the first shape")

    def at(self, time_s: float) -> Template:
        """The shape to form at a time."""
        begun = [shape for at_s, shape in self.later if at_s <= time_s + 1e-9]
        return begun[-1] if begun else self.first
