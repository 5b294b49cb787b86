"""Compositing of flat shapes over an image: grids of grey cells, such as marker cards, and discs.

A pixel becomes `F + (1 - A) background`, where F is the light of the shape in the pixel and A the coverage of
the pixel by the shape (`render/native/render.h`).
"""

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, IntArray, inverse
from skyherd.render.edge import REACH, EdgeSpread, Float
from skyherd.render.native.library import Canvas, FlatShapes, library
from skyherd.render.view import ShapeImages

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
    m = levels.shape[1] - 2.0
    corners = np.array([[0.0, 0.0], [m, 0.0], [m, m], [0.0, m]])
    numbers, shapes = _in_view(images, corners, spread)
    library().draw_lattices(canvas, images.frame(), shapes, levels[numbers], spread)


def paint_discs(canvas: Canvas, images: ShapeImages, levels: Array, spread: EdgeSpread) -> None:
    """Draw discs of grey `levels` (N,) over the canvas, in place; `images` take the unit disc to pixels."""
    numbers, shapes = _in_view(images, RING, spread)
    library().draw_discs(canvas, images.frame(), shapes, levels[numbers].astype(np.float32), spread)


def _in_view(images: ShapeImages, corners: Array, spread: EdgeSpread) -> tuple[IntArray, FlatShapes]:
    """Return the numbers (M,) of the shapes that may affect a pixel, and these shapes.

    Args:
        images: images of the shapes.
        corners: (V, 2) corners of a polygon around a shape, in shape coordinates.
        spread: edge spread function of lens and pixel.
    """
    size_px, margin_px = images.camera.size_px, REACH * spread.sigma_px
    ahead = np.flatnonzero(images.before_horizon(corners))
    outlines = images.only(ahead).project(corners)
    if images.bent:
        middles = images.only(ahead).project((corners + np.roll(corners, -1, axis=0)) / 2)
        chords = (outlines + np.roll(outlines, -1, axis=1)) / 2
        margin_px += 1.5 * float(np.abs(middles - chords).max(initial=0.0))
    low, high = outlines.min(axis=1) - margin_px, outlines.max(axis=1) + margin_px
    inside = ((low < size_px) & (high > -1)).all(axis=1)
    numbers = ahead[inside]
    matrices = np.ascontiguousarray(inverse(images.matrices[:, numbers]))
    return numbers, FlatShapes(np.ascontiguousarray(outlines[inside]), matrices, margin_px)
