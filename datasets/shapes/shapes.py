"""Named formation shapes: points (N, 2) in map sense, x right and y up, each shape in a unit of its own."""

from collections.abc import Callable

import numpy as np

from skyherd.datasets.shapes.words import PREFIX, word_points
from skyherd.errors import InputError
from skyherd.geometry import Array
from skyherd.messages.checks import check_count, check_kind
from skyherd.text import one_of

STAR_INNER_RATIO = 0.515
"""Inner over outer radius of the star. *Derived* from the paper's second simulation: 4.12 / 8."""

MIN_STAR = 6
"""Robots of the smallest star. *Derived*: three tips and three notches; fewer make no star."""


MAX_POINTS = 10_000
"""Most points of a shape. *Chosen*: as many as a scenario may have robots."""


def circle(count: int) -> Array:
    """`count` points, evenly spaced on a circle of radius 1, counter-clockwise from angle 0."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.column_stack([np.cos(angle), np.sin(angle)])


def star(count: int) -> Array:
    """A star: tips at radius 1 and notches at `STAR_INNER_RATIO` in turn, counter-clockwise from angle 0.

    Raises:
        InputError: `count` is odd, or less than 6.
    """
    if count % 2 or count < MIN_STAR:
        raise InputError(
            "template.shape", f"a star of {count} robots", "an even number of robots, at least 6"
        )
    radius = np.where(np.arange(count) % 2 == 0, 1.0, STAR_INNER_RATIO)
    points: Array = radius[:, None] * circle(count)
    return points


def grid(count: int) -> Array:
    """A grid of spacing 1 about its middle, filled row by row, as near to a square as `count` divides."""
    columns = next(c for c in range(int(np.ceil(np.sqrt(count))), count + 1) if count % c == 0)
    index = np.arange(count)
    points: Array = np.column_stack([index % columns, index // columns]).astype(float)
    return np.asarray(points - points.mean(axis=0))


def line(count: int) -> Array:
    """`count` points along x, spacing 1, about their middle."""
    return np.column_stack([np.arange(count) - (count - 1) / 2, np.zeros(count)])


def triangle(count: int) -> Array:
    """Evenly spaced along an equilateral triangle of side 2, with a robot at each corner.

    Raises:
        InputError: `count` is no multiple of 3.
    """
    if count % 3:
        raise InputError("template.shape", f"a triangle of {count} robots", "a multiple of 3")
    corners = 2 / np.sqrt(3) * np.exp(1j * np.radians([90, 210, 330]))
    along = np.arange(count // 3) / (count // 3)
    points = (corners[:, None] + along * (np.roll(corners, -1) - corners)[:, None]).ravel()
    return np.column_stack([points.real, points.imag])


SHAPES: dict[str, Callable[[int], Array]] = {
    "circle": circle,
    "grid": grid,
    "line": line,
    "star": star,
    "triangle": triangle,
}
"""Functions from a number of robots to the points of a shape, by the shape's name."""


def shape_points(name: str, count: int) -> Array:
    """Points (N, 2), x right and y up, of a named shape, or of a word such as `word:SKY`, for `count` robots.

    Raises:
        InputError: there is no such shape, or not for so many robots, or `count` is no whole number up to
            MAX_POINTS; the error says what there is.
    """
    check_kind("template.shape", name, str, "a text")
    check_count("template.shape: count", count, most=MAX_POINTS)
    if name.startswith(PREFIX):
        return word_points(name.removeprefix(PREFIX), count)
    if name not in SHAPES:
        raise InputError("template.shape", f"no shape {name!r}", f"{one_of(name, SHAPES)}, {PREFIX}SKY")
    return SHAPES[name](count)
