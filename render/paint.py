"""Lays flat shapes over an image: grids of grey cells, such as marker cards, and discs.

Each pixel keeps what the shape does not cover of it: `F + (1 - A) background`, with F the shape's light that
the pixel gathers and A the share of the pixel that it covers.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, IntArray
from skyherd.render.raster.edge import PER_SIGMA, REACH, EdgeSpread
from skyherd.render.raster.lattice import Lattices, gather_light
from skyherd.render.raster.pixels import Float, Pixels, locate
from skyherd.render.raster.spans import cover
from skyherd.render.view import ShapeImages

Canvas = npt.NDArray[np.uint8] | Float
"""An image (height, width) that is drawn on: grey levels of 8 bits, or light as float32."""

CHUNK_PX = 50_000
"""Pixels worked on at a time. *Chosen*: the arrays computed on them, some 200 KB each, stay in cache; larger
ones wait for memory, smaller ones for Python."""

RING: Array = 1.0824 * np.exp(2j * np.pi * (np.arange(8) + 0.5) / 8).view(float).reshape(8, 2)
"""Corners (8, 2) of an octagon around the unit circle. *Derived*: its corners lie just beyond `1 / cos(π / 8)
= 1.08239`, so that its sides do not cut the circle."""

MIDDLE = 1e-6
"""Least distance of a pixel from a disc's centre, in radii. *Chosen*: there the direction outwards is not
defined, and the disc is far from its edge anyhow."""

LEAST_SPREAD = 1e-12
"""Least variance of an edge's blur across a disc's radius, in squared radii. *Chosen*: keeps a division from
zero where a pixel lies in the disc's centre; it is far below a pixel of any image."""


def paint_lattices(canvas: Canvas, images: ShapeImages, lattices: Lattices, spread: EdgeSpread) -> None:
    """Lay grids of grey cells over the canvas, in place, each over those before it.

    Args:
        canvas: the image drawn on.
        images: of the grids; they take (column, row), from 0 to the number of cells, to pixels.
        lattices: the grids' grey levels.
        spread: how lens and pixel spread an edge.
    """
    m = float(lattices.cells)
    corners = np.array([[0.0, 0.0], [m, 0.0], [m, m], [0.0, m]])
    for pixels in _pixels(images, corners, spread):
        light, covered = gather_light(pixels, lattices, spread.table)
        _lay(canvas, pixels, light, covered)


def paint_discs(canvas: Canvas, images: ShapeImages, levels: Array, spread: EdgeSpread) -> None:
    """Lay discs of grey `levels` (N,) over the canvas, in place; `images` take the unit disc to pixels.

    Their edge is taken as straight, and for its curvature moved inwards by `σ² / 2 R`, which leaves the disc
    its area: right where it is much larger than the blur.
    """
    for pixels in _pixels(images, RING, spread):
        x, y = pixels.x, pixels.y
        radius = np.maximum(np.hypot(x.at, y.at), MIDDLE)
        across_x, across_y = x.at / x.sharpness, y.at / y.sharpness
        square = across_x**2 + across_y**2
        if pixels.corner is not None:
            square += 2 * pixels.corner.correlation * across_x * across_y
        sigma = np.sqrt(np.maximum(square, LEAST_SPREAD)) / radius
        distance = (1 - radius) / sigma - sigma / 2
        place = np.clip(distance, -REACH, REACH) * np.float32(PER_SIGMA) + x.table_start
        covered = spread.table.take(place.astype(np.intp))
        _lay(canvas, pixels, levels.astype(np.float32).take(pixels.shape) * covered, covered)


def _lay(canvas: Canvas, pixels: Pixels, light: Float, covered: Float) -> None:
    """Light and cover (P,) over what is there: `F + (1 - A) background`, rounded if that is of 8 bits."""
    flat = canvas.reshape(-1)
    seen = (1 - covered) * flat.take(pixels.index, mode="wrap")
    seen += light
    flat[pixels.index] = seen if canvas.dtype == np.float32 else np.rint(seen, out=seen)


def _pixels(images: ShapeImages, corners: Array, spread: EdgeSpread) -> Iterator[Pixels]:
    """Pixels of all shapes that are seen, in parts in which no two of them overlap.

    A shape is bounded by `corners` (V, 2) in its own coordinates.
    """
    size_px, margin = images.camera.size_px, REACH * spread.sigma_px
    ahead = np.flatnonzero(images.before_horizon(corners))
    outlines = images.only(ahead).project(corners)
    if images.bent:
        middles = images.only(ahead).project((corners + np.roll(corners, -1, axis=0)) / 2)
        chords = (outlines + np.roll(outlines, -1, axis=1)) / 2
        margin += 1.5 * float(np.abs(middles - chords).max(initial=0.0))
    low, high = outlines.min(axis=1) - margin, outlines.max(axis=1) + margin
    inside = np.flatnonzero(((low < size_px) & (high > -1)).all(axis=1))
    lens = images.lens()
    for part in _apart(low[inside], high[inside]):
        seen = inside[part]
        spans = cover(outlines[seen], margin, size_px)
        for chunk in replace(spans, shape=ahead[seen][spans.shape]).chunks(CHUNK_PX):
            yield locate(chunk, images.shapes_image(chunk), spread, size_px[0], lens)


def _apart(low: Array, high: Array) -> list[IntArray]:
    """Indices of boxes (N, 2) to (N, 2) in layers without overlap, each box above those before it."""
    layer = np.zeros(len(low), dtype=np.int64)
    before = low[:, None] < high
    meet = (before & before.transpose(1, 0, 2)).all(axis=-1)
    for later, earlier in np.argwhere(np.tril(meet, -1)).tolist():
        layer[later] = max(layer[later], layer[earlier] + 1)
    return [np.flatnonzero(layer == number) for number in range(int(layer.max(initial=-1)) + 1)]
