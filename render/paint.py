"""Compositing of flat shapes over an image: grids of grey cells, such as marker cards, and discs.

A pixel becomes `F + (1 - A) background`, where F is the light of the shape in the pixel and A the coverage of
the pixel by the shape (`skyherd.render.raster.kernels`).
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, inverse
from skyherd.render.raster.edge import REACH, EdgeSpread, Float
from skyherd.render.view import ShapeImages

Canvas = npt.NDArray[np.uint8] | Float
"""Image (height, width) to draw on: grey levels of 8 bits, or light as float32."""

RING: Array = 1.0824 * np.exp(2j * np.pi * (np.arange(8) + 0.5) / 8).view(float).reshape(8, 2)
"""Corners (8, 2) of an octagon around the unit circle. *Derived*: its corners lie just beyond `1 / cos(π / 8)
= 1.08239`, so that its sides do not cut the circle."""


def framed(levels: npt.NDArray[np.floating]) -> Float:
    """Return grey levels (N, m, m) of grids, rows along y, with a border of zeros: (N, m + 2, m + 2)."""
    return np.pad(levels.astype(np.float32), ((0, 0), (1, 1), (1, 1)))


def paint_lattices(canvas: Canvas, images: ShapeImages, levels: Float, spread: EdgeSpread) -> None:
    """Draw grids of grey cells over the canvas, in place, in their order.

    Args:
        canvas: the image to draw on.
        images: images of the N grids, from (column, row), 0 to the number of cells, to pixels.
        levels: grey levels (N, m + 2, m + 2) of the grids, from `framed`.
        spread: edge spread function of lens and pixel.
    """
    # Imported here, since it takes half a second and processes that draw nothing do not need it.
    from skyherd.render.raster.kernels.lattices import lay_lattices

    m = levels.shape[1] - 2.0
    corners = np.array([[0.0, 0.0], [m, 0.0], [m, m], [0.0, m]])
    lay_lattices(levels, spread.kurtosis, *_arguments(canvas, images, corners, spread))


def paint_discs(canvas: Canvas, images: ShapeImages, levels: Array, spread: EdgeSpread) -> None:
    """Draw discs of grey `levels` (N,) over the canvas, in place; `images` take the unit disc to pixels."""
    from skyherd.render.raster.kernels.discs import lay_discs  # as above

    lay_discs(levels.astype(np.float32), *_arguments(canvas, images, RING, spread))


def _arguments(canvas: Canvas, images: ShapeImages, corners: Array, spread: EdgeSpread) -> tuple[Any, ...]:
    """Return the last arguments of a kernel (`kernels.pixels.SHAPES`), for the shapes in view.

    Of the arguments image and light, the one that is not the canvas is empty.

    Args:
        canvas: the image to draw on.
        images: images of the shapes.
        corners: (V, 2) corners of a polygon around a shape, in shape coordinates.
        spread: edge spread function of lens and pixel.
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
