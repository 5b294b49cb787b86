"""Where an image's pixels lie in the flat shapes that they see, and how lens and pixel blur act there.

Drawing goes from pixels to shapes: each pixel is mapped into the coordinates of the shape that it sees, and
the gradient of that map says how wide the blur is there.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array
from skyherd.render.camera.lens_displacement import LensField
from skyherd.render.raster.edge import EdgeSpread
from skyherd.render.raster.spans import Spans

Float = npt.NDArray[np.float32]
"""Numbers of single precision: half the memory, and exact to 1e-4 px in the largest image."""

Index = npt.NDArray[np.intp]
"""Numbers of pixels, shapes or entries of a table."""

SQUARE = 1e-3
"""Correlation of the two axes below which a corner is the product of its edges. *Derived*: `200 ρ φ(0)²` is
0.03 grey levels of 200."""

BOXY = 0.03
"""Fourth cumulant of the pixel, over σ⁴, below which corners leave it out. *Derived*: 0.1 grey levels of 200
at most."""

AFFINE = 1e-7
"""Change of a map's scale from pixel to pixel below which it counts as affine. *Derived*: over a run of 1000
pixels the place is then off by 1e-4 of the run."""


@dataclass(frozen=True)
class Axis:
    """Where pixels lie along one axis of their shapes, and how far they feel an edge across it.

    Attributes:
        at: (P,) coordinate x, in the shape's units.
        sharpness: (P,) `1 / (σ |∇x|)`: how many σ one unit of x is.
        table_start: (P,) place of distance zero in the edge table, for edges across this axis.
    """

    at: Float
    sharpness: Float
    table_start: Float


@dataclass(frozen=True)
class Pixels:
    """Pixels of some spans, in the coordinates of their shapes.

    Attributes:
        index: (P,) in the flattened image.
        shape: (P,) number of the shape that each of them sees.
        x: first coordinate.
        y: second coordinate.
        corner: by how much a corner differs from the product of two edges; None if not at all.
    """

    index: Index
    shape: Index
    x: Axis
    y: Axis
    corner: "Corner | None"


@dataclass(frozen=True)
class Corner:
    """Joint cumulants of lens and pixel across lines of x and of y, over powers of σ, each (P,).

    Attributes:
        correlation: ρ, cosine of the angle between the gradients of x and y.
        even: κ_22 / 4.
        odd_x: κ_31 / 6.
        odd_y: κ_13 / 6.
    """

    correlation: Float
    even: Float
    odd_x: Float
    odd_y: Float


def locate(
    spans: Spans, shape_image: Array, spread: EdgeSpread, width_px: int, lens: LensField | None = None
) -> Pixels:
    """Map the pixels of runs into the coordinates of their shapes.

    Args:
        spans: runs of pixels, R of them.
        shape_image: (R, 3, 3) homographies from pixels without the lens to shape coordinates.
        spread: how lens and pixel spread an edge.
        width_px: width of the image.
        lens: what its distortion does to each pixel; None if nothing.
    """
    counts = spans.count
    before = np.cumsum(counts) - counts
    number = np.arange(before[-1] + counts[-1])
    index = number + np.repeat(spans.v * width_px + spans.u - before, counts)
    step = (number - np.repeat(before, counts)).astype(np.float32)

    def each(values: npt.NDArray[np.number]) -> Float:
        return np.repeat(values.astype(np.float32), counts)

    # Coordinates are (x, y) / w, w being 1 where a run begins: near enough to it to keep precise in float32.
    first = np.stack([spans.u, spans.v, np.ones(counts.size)], axis=-1)
    begin = (shape_image @ first[..., None])[..., 0]
    rows = shape_image / begin[:, 2, None, None]
    begin = begin / begin[:, 2:]
    places = [each(begin[:, i]) + each(rows[:, i, 0]) * step for i in (0, 1)]
    slopes = rows[:, :2, :2] - begin[:, :2, None] * rows[:, None, 2, :2]
    lengths = np.sqrt((slopes**2).sum(axis=-1))
    normals = slopes / lengths[..., None]
    cosines = (normals[:, 0] * normals[:, 1]).sum(axis=-1)
    has_corner = spread.kurtosis < -BOXY or lens is not None or float(np.abs(cosines).max()) > SQUARE
    if lens is None and float(np.abs(rows[:, 2, :2]).max()) < AFFINE:
        sharpness = [each(1 / (spread.sigma_px * lengths[:, i])) for i in (0, 1)]
        correlation = each(cosines) if has_corner else None
    else:
        sharpness, correlation = _across(places, rows, step, index, spread.sigma_px, each, lens)
    corner = None
    if has_corner and correlation is not None:
        a, b = normals[:, 0], normals[:, 1]
        joint = ((a**2 * b**2, 4), (a**3 * b, 6), (a * b**3, 6))
        corner = Corner(correlation, *(each(spread.kurtosis / of * k.sum(axis=-1)) for k, of in joint))
    starts = spread.start(normals)
    x, y = (Axis(places[i], sharpness[i], each(starts[:, i])) for i in (0, 1))
    return Pixels(index=index, shape=np.repeat(spans.shape, counts), x=x, y=y, corner=corner)


def _across(
    places: list[Float],
    rows: Array,
    step: Float,
    index: Index,
    sigma_px: float,
    each: Callable[[Array], Float],
    lens: LensField | None,
) -> tuple[list[Float], Float]:
    """Sharpness along x and y, and correlation, at each pixel; `places` become coordinates in place."""
    w = 1 + each(rows[:, 2, 0]) * step
    if lens is not None:
        du, dv = lens.shift_u.take(index), lens.shift_v.take(index)
        for row, place in enumerate((*places, w)):
            place += each(rows[:, row, 0]) * du + each(rows[:, row, 1]) * dv
    w_slopes = [each(rows[:, 2, j]) for j in (0, 1)]
    slopes = []
    for row, place in enumerate(places):
        place /= w
        slopes.append([each(rows[:, row, j]) - place * w_slopes[j] for j in (0, 1)])
    if lens is not None:
        uu, uv, vu, vv = (field.take(index) for field in lens.slopes)
        slopes = [[a * uu + b * vu, a * uv + b * vv] for a, b in slopes]
    lengths = [np.sqrt(a * a + b * b) for a, b in slopes]
    (a, b), (c, d) = slopes
    w /= np.float32(sigma_px)
    return [w / length for length in lengths], (a * c + b * d) / (lengths[0] * lengths[1])
