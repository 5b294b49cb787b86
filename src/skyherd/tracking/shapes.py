"""The shape that tracks are held against: a scenario's, or a named one for the markers that were seen."""

from typing import Protocol

from skyherd.control import Template
from skyherd.datasets import SHAPES, load_mission, shape_points
from skyherd.errors import InputError
from skyherd.geometry import IntArray


class ShapeSource(Protocol):
    """Gives the template for the markers that a recording shows."""

    def __call__(self, ids: IntArray) -> Template:
        """The template, given the markers (N,), ascending."""
        ...


def named_shape(name: str) -> ShapeSource:
    """A named shape, such as `circle` or `word:SKY`, whose points go to the markers in ascending order.

    Raises:
        InputError: there is no such shape.
    """
    if name not in SHAPES and not name.startswith("word:"):
        raise InputError("--shape", f"no shape {name!r}", f"one of {', '.join(SHAPES)}, word:SKY")
    return lambda ids: Template.from_ground_points(ids, shape_points(name, int(ids.size)))


def scenario_shape(name: str) -> ShapeSource:
    """The first shape of a built-in scenario or of a scenario file, for the robots that it has.

    Raises:
        InputError: there is no such scenario, or it is not right.
    """
    template = load_mission(name).template
    return lambda ids: template
