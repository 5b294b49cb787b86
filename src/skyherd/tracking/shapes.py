"""Reference shapes of tracks: the shape of a scenario, or a named one for the detected markers."""

from typing import Protocol

from skyherd.control import Template
from skyherd.datasets import SHAPES, load_mission, shape_points
from skyherd.errors import InputError
from skyherd.geometry import IntArray
from skyherd.markers.layout import MarkerLayout


class ShapeSource(Protocol):
    """Source of the template for the markers of a recording."""

    def __call__(self, ids: IntArray) -> Template:
        """Return the template for the markers (N,), ascending."""
        ...


def named_shape(name: str) -> ShapeSource:
    """Return a named shape, such as `circle` or `word:SKY`; the markers take its points in ascending order.

    Raises:
        InputError: no shape has that name.
    """
    if name not in SHAPES and not name.startswith("word:"):
        raise InputError("shape", f"no shape {name!r}", f"one of {', '.join(SHAPES)}, word:SKY")
    return lambda ids: Template.from_ground_points(ids, shape_points(name, int(ids.size)))


def scenario_shape(name: str) -> tuple[ShapeSource, MarkerLayout | None]:
    """Return the first shape of a built-in scenario or a scenario file, and the markers on its robots.

    The layout is None for one marker on each robot.

    Raises:
        InputError: the scenario does not exist, or is invalid.
    """
    mission = load_mission(name)
    return lambda ids: mission.template, mission.layout
