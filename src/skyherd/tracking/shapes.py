"""The shape that tracks are held against: a scenario's, or a named one for the markers that were seen."""

from pathlib import Path
from typing import Protocol

from skyherd.control import Template
from skyherd.datasets import SHAPES, load_mission, scenario_names, shape_points
from skyherd.errors import InputError
from skyherd.geometry import IntArray


class ShapeSource(Protocol):
    """Gives the template for the markers that a recording shows."""

    def __call__(self, ids: IntArray) -> Template:
        """The template, given the markers (N,), ascending."""
        ...


def shape_source(name: str) -> ShapeSource:
    """The shape that a name means.

    Args:
        name: a named shape, such as `circle` or `word:SKY`, whose points go to the markers in ascending
            order; or a scenario file or another built-in scenario, whose robots and first shape count.

    Raises:
        InputError: it is neither.
    """
    if name in SHAPES or name.startswith("word:"):
        return lambda ids: Template.from_ground_points(ids, shape_points(name, int(ids.size)))
    if name not in scenario_names() and Path(name).suffix != ".toml":
        raise InputError(
            "--shape", f"no shape {name!r}", f"{', '.join(SHAPES)}, word:SKY, a scenario or its file"
        )
    template = load_mission(name).template
    return lambda ids: template
