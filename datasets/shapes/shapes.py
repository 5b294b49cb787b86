"""Named formation shapes: points (N, 2), x right and y up, each shape in its own unit of length."""

from collections.abc import Callable

import numpy as np

from skyherd.datasets.shapes.words import PREFIX, word_outline, word_points
from skyherd.errors import InputError
from skyherd.geometry import Array
from skyherd.messages.checks import check_count, check_kind
from skyherd.text import one_of

STAR_INNER_RATIO = 0.515
"""Inner over outer radius of the star. Derived from the paper's second simulation: 4.12 / 8."""

MIN_STAR = 6
"""Minimum number of robots of a star. Derived: three tips and three notches."""


CIRCLE_SIDES = 120
"""Number of sides of the polygon that is drawn as a circle. Chosen: within 0.04 % of the radius."""

MAX_POINTS = 10_000
"""Maximum number of points of a shape. Chosen: the maximum number of robots of a scenario."""


def circle(count: int) -> Array:
    """Return `count` points, evenly spaced on a circle of radius 1, counter-clockwise from angle 0."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.column_stack([np.cos(angle), np.sin(angle)])


def star(count: int) -> Array:
    """Return a star with tips at radius 1, notches at `STAR_INNER_RATIO`, counter-clockwise from angle 0.

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
    """Return a centred grid of spacing 1, filled row by row, as square as the divisors of `count` allow."""
    columns = next(c for c in range(int(np.ceil(np.sqrt(count))), count + 1) if count % c == 0)
    index = np.arange(count)
    points: Array = np.column_stack([index % columns, index // columns]).astype(float)
    return np.asarray(points - points.mean(axis=0))


def line(count: int) -> Array:
    """Return `count` points along x with spacing 1, centred."""
    return np.column_stack([np.arange(count) - (count - 1) / 2, np.zeros(count)])


def triangle(count: int) -> Array:
    """Return points evenly spaced along an equilateral triangle of side 2, with one at each corner.

    Raises:
        InputError: `count` is not a multiple of 3.
    """
    if count % 3:
        raise InputError("template.shape", f"a triangle of {count} robots", "a multiple of 3")
    corners = 2 / np.sqrt(3) * np.exp(1j * np.radians([90, 210, 330]))
    along = np.arange(count // 3) / (count // 3)
    points = (corners[:, None] + along * (np.roll(corners, -1) - corners)[:, None]).ravel()
    return np.column_stack([points.real, points.imag])


def _closed(points: Array) -> list[Array]:
    """Return the polygon through points (N, 2) as one closed polyline."""
    return [np.concatenate([points, points[:1]])]


def _grid_lines(count: int) -> list[Array]:
    """Return the rows and the columns of the grid of `count` points."""
    points = grid(count)
    rows = int(np.unique(points[:, 1]).size)
    lattice = points.reshape(rows, -1, 2)
    lines = [*lattice, *lattice.swapaxes(0, 1)]
    return [line for line in lines if len(line) > 1]


OUTLINES: dict[str, Callable[[int], list[Array]]] = {
    "circle": lambda count: _closed(circle(CIRCLE_SIDES)),
    "grid": _grid_lines,
    "line": lambda count: [line(count)],
    "star": lambda count: _closed(star(count)),
    "triangle": lambda count: _closed(triangle(count)),
}
"""Functions from a number of robots to the outline of a shape, by the shape's name."""

SHAPES: dict[str, Callable[[int], Array]] = {
    "circle": circle,
    "grid": grid,
    "line": line,
    "star": star,
    "triangle": triangle,
}
"""Functions from a number of robots to the points of a shape, by the shape's name."""


def shape_points(name: str, count: int) -> Array:
    """Return the points (N, 2), x right and y up, of a named shape or of a word such as `word:SKY`.

    Raises:
        InputError: the shape does not exist, or not for this number of robots; or `count` is not a whole
            number up to `MAX_POINTS`. The error lists the allowed values.
    """
    check_kind("template.shape", name, str, "a text")
    check_count("template.shape: count", count, most=MAX_POINTS)
    if name.startswith(PREFIX):
        return word_points(name.removeprefix(PREFIX), count)
    if name not in SHAPES:
        raise InputError("template.shape", f"no shape {name!r}", f"{one_of(name, SHAPES)}, {PREFIX}SKY")
    return SHAPES[name](count)


def shape_outline(name: str, count: int) -> list[Array]:
    """Return the lines of a named shape or word as polylines (M, 2), in the frame of `shape_points`.

    A word has the strokes of its letters, which no line connects.

    Raises:
        InputError: as in `shape_points`.
    """
    shape_points(name, count)
    if name.startswith(PREFIX):
        return word_outline(name.removeprefix(PREFIX))
    return OUTLINES[name](count)
