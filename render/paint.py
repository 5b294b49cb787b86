"""Lays flat shapes over an image: grids of grey cells, such as marker cards, and discs.

Each pixel keeps what the shape does not cover of it: `F + (1 - A) background`, with F the shape's light that
the pixel gathers and A the share of the pixel that it covers (`skyherd.render.raster.kernels`).
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, inverse
from skyherd.render.raster.edge import REACH, EdgeSpread, Float
from skyherd.render.view import ShapeImages

Canvas = npt.NDArray[np.uint8] | Float
"""An image (height, width) that is drawn on: grey levels of 8 bits, or light as float32."""

RING: Array = 1.0824 * np.exp(2j * np.pi * (np.arange(8) + 0.5) / 8).view(float).reshape(8, 2)
"""Corners (8, 2) of an octagon around the unit circle. *Derived*: its corners lie just beyond `1 / cos(π / 8)
= 1.08239`, so that its sides do not cut the circle."""


def framed(levels: npt.NDArray[np.floating]) -> Float:
    """Return grey levels (N, m, m) of grids in a border of empty cells, for `paint_lattices`."""
    return np.pad(levels.astype(np.float32), ((0, 0), (1, 1), (1, 1)))


def paint_lattices(canvas: Canvas, images: ShapeImages, levels: Float, spread: EdgeSpread) -> None:
    """Lay grids of grey cells over the canvas, in place, each over those before it.

    Args:
        canvas: the image drawn on.
        images: of the N grids; they take (column, row), from 0 to the number of cells, to pixels.
        levels: the grids' grey levels (N, m + 2, m + 2), `framed`.
        spread: how lens and pixel spread an edge.
    """
    # Imported with the first shape that is drawn: it takes half a second, and who draws nothing does without.
    from skyherd.render.raster.kernels.lattices import lay_lattices

    m = levels.shape[1] - 2.0
    corners = np.array([[0.0, 0.0], [m, 0.0], [m, m], [0.0, m]])
    lay_lattices(levels, spread.kurtosis, *_arguments(canvas, images, corners, spread))


def paint_discs(canvas: Canvas, images: ShapeImages, levels: Array, spread: EdgeSpread) -> None:
    """Lay discs of grey `levels` (N,) over the canvas, in place; `images` take the unit disc to pixels."""
    from skyherd.render.raster.kernels.discs import lay_discs  # as above

    lay_discs(levels.astype(np.float32), *_arguments(canvas, images, RING, spread))


def _arguments(canvas: Canvas, images: ShapeImages, corners: Array, spread: EdgeSpread) -> tuple[Any, ...]:
    """Return the last arguments of kernels (`kernels.pixels.SHAPES`) for shapes with `corners` (V, 2).

    Only shapes that are seen are among them. Of image and light the one is empty that the canvas is not.
    """
    size_px, margin = images.camera.size_px, REACH * spread.sigma_px
    ahead = np.flatnonzero(images.before_horizon(corners))
    outlines = images.only(ahead).project(corners)
    if images.bent:
        middles = images.only(ahead).project((corners + np.roll(corners, -1, axis=0)) / 2)
        chords = (outlines + np.roll(outlines, -1, axis=1)) / 2
        margin += 1.5 * float(np.abs(middles - chords).max(initial=0.0))
    low, high = outlines.min(axis=1) - margin, outlines.max(axis=1) + margin
    inside = ((low < size_px) & (high > -1)).all(axis=1)
    numbers = ahead[inside]
    lens = images.lens()
    return (
        canvas if canvas.dtype == np.uint8 else np.empty((0, 0), np.uint8),
        canvas if canvas.dtype == np.float32 else np.empty((0, 0), np.float32),
        np.ascontiguousarray(outlines[inside]),
        numbers,
        np.ascontiguousarray(inverse(images.matrices[:, numbers])),
        images.row_times(),
        np.zeros((6, 0), np.float32) if lens is None else lens.fields,
        margin,
        spread.sigma_px,
        spread.table,
    )
