"""Draws flat grids of grey cells, such as marker cards, exactly, at the pixels themselves.

In a lattice's own coordinates (column x, row y, in cells) its light is a sum of steps at the lattice's lines.
A pixel whose lens and aperture spread light by S (`skyherd.render.raster.edge`) gathers from it

    F = Σ_j Σ_k  T_jk S_j(y) S_k(x),      S_k(x) = S((x - k) / (σ |∇x|)),

where T_00 is a cell's level, T_0k and T_j0 the steps of level from cell to cell along x and along y, and
T_jk, for j, k > 0, the steps of those steps. Only the K lines nearest to the pixel count on either axis: all
that it feels. Distances are taken in the image, across each pixel, so that tilt, perspective, skew and lens
need no care of their own but one: lines that meet at an angle in the image. With ρ the cosine between the
gradients of x and y, the two factors are correlated, and by Plackett's identity (1954) they gather more by

    ∫_0^ρ φ_r(y_j, x_k) dr  ≈  ρ φ_{ρ/2}(y_j, x_k),

φ_r being the binormal density of correlation r: the midpoint rule, right to 0.1 grey levels of 200 at ρ =
0.3; where |ρ| is more, at the rim of a fisheye, Gauss's rule with two nodes. Where the pixel's square is
wide beside the lens, its joint fourth cumulants add Edgeworth terms. Nothing is sampled, filtered or kept
from one image to the next.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.render.raster.edge import PER_SIGMA, REACH
from skyherd.render.raster.pixels import Axis, Corner, Float, Index, Pixels

SLANTED = 0.35
"""Correlation ρ from which on the integral over r takes two nodes in place of one. *Chosen*: the midpoint
rule is right to 0.1 grey levels of 200 at 0.3; two nodes cost twice as much."""

MIDPOINT = (0.5,)
"""Nodes of the midpoint rule, as shares of ρ."""

GAUSS = (0.5 - 12**-0.5, 0.5 + 12**-0.5)
"""Nodes of Gauss's rule of two points, as shares of ρ. *Derived*: `(1 ± 1/√3) / 2`."""

FELT = 3.4
"""Distance in σ beyond which a line is left out. *Derived*: `200 Φ(-3.4)`, 0.07 grey levels of 200, are left
there. More lines a pixel cost more."""

LEAST_SHARPNESS = 1e-6
"""Least cells to one σ. *Chosen*: keeps a division from zero; such a card is far smaller than a pixel."""


@dataclass(frozen=True)
class Lattices:
    """N grids of one size: the steps T of their levels, flattened, each grid padded by one empty cell.

    Attributes:
        cells: m, number of cells along a side.
        light: T of the grey levels: ((T_00, T_0k), (T_j0, T_jk)), N grids.
        inside: T_0 and T_k along one axis of a grid whose cells are all 1: for the share that is covered.
        corners: T_jk of the same grid.
    """

    cells: int
    light: tuple[tuple[Float, Float], tuple[Float, Float]]
    inside: tuple[Float, Float]
    corners: Float

    @classmethod
    def of(cls, levels: npt.NDArray[np.floating]) -> "Lattices":
        """The steps of grids with grey levels (N, m, m), rows along y."""
        cells = levels.shape[1]
        padded = np.pad(levels.astype(np.float32), ((0, 0), (1, 1), (1, 1)))
        along_x = np.diff(padded, axis=2, append=np.float32(0))
        along_y, both = (np.diff(grid, axis=1, append=np.float32(0)) for grid in (padded, along_x))
        inside = np.pad(np.ones(cells, np.float32), 1)
        edge = np.diff(inside, append=np.float32(0))
        return cls(
            cells=cells,
            light=((padded.ravel(), along_x.ravel()), (along_y.ravel(), both.ravel())),
            inside=(inside, edge),
            corners=np.outer(edge, edge).ravel(),
        )


@dataclass(frozen=True)
class NearestLines:
    """The K lines nearest to each pixel on one axis.

    Attributes:
        first: (P,) cell before the first of them, in a padded grid.
        distance: K times (P,) distance from each line, σ.
        spread: K times (P,) S of it.
    """

    first: Float
    distance: list[Float]
    spread: list[Float]


def _gather(axis: Axis, lines: int, cells: int, table: Float) -> NearestLines:
    """The nearest lines of each pixel along one axis, with S of their distances."""
    first = np.floor(axis.at + np.float32(1 - lines / 2))
    np.clip(first, 0, cells + 1 - lines, out=first)
    nearest = (axis.at - first) * axis.sharpness
    distances = [nearest - np.float32(line) * axis.sharpness for line in range(lines)]
    spread = []
    for distance in distances:
        place = np.clip(distance, -REACH, REACH)
        place *= np.float32(PER_SIGMA)
        place += axis.table_start
        spread.append(table.take(place.astype(np.intp), mode="wrap"))
    return NearestLines(first, distances, spread)


def gather_light(pixels: Pixels, lattices: Lattices, table: Float) -> tuple[Float, Float]:
    """The light F (P,) that pixels gather from their lattices, and the share A (P,) of each that is covered.

    F is in grey levels and already weighed by the cover: what a lattice does not cover adds nothing.

    Args:
        pixels: P pixels, each in the coordinates of its own lattice.
        lattices: the grids' levels.
        table: S, as `EdgeSpread` has it.
    """
    cells, width = lattices.cells, lattices.cells + 2
    softest = min(float(pixels.x.sharpness.min()), float(pixels.y.sharpness.min()))
    lines = int(np.clip(np.ceil(2 * FELT / max(softest, LEAST_SHARPNESS)), 1, cells + 1))
    x = _gather(pixels.x, lines, cells, table)
    y = _gather(pixels.y, lines, cells, table)
    one_grid = (x.first + np.float32(width) * y.first).astype(np.intp)
    base = one_grid + pixels.shape * (width * width)
    (level, along_x), (along_y, both) = lattices.light
    light = _sum(level, along_x, base, x.spread)
    for j, spread in enumerate(y.spread):
        light += _sum(along_y[j * width :], both[j * width :], base, x.spread) * spread
    inside = lattices.inside
    cover = _sum(*inside, x.first.astype(np.intp), x.spread) * _sum(
        *inside, y.first.astype(np.intp), y.spread
    )
    if pixels.corner is not None:
        nodes = GAUSS if float(np.abs(pixels.corner.correlation).max()) > SLANTED else MIDPOINT
        for j, k in np.ndindex(lines, lines):
            more = _at_corner(pixels.corner, x.distance[k], y.distance[j], nodes)
            light += both[j * width + k :].take(base, mode="wrap") * more
            cover += lattices.corners[j * width + k :].take(one_grid, mode="wrap") * more
    return light, cover


def _at_corner(corner: Corner, x: Float, y: Float, nodes: tuple[float, ...]) -> Float:
    """What the corner at distances x, y (P,), in σ, adds to the product of its two edges."""
    density = sum(_binormal(np.float32(share) * corner.correlation, x, y) for share in nodes) / len(nodes)
    cumulants = corner.even * x * y + corner.odd_x * (x * x - 1) + corner.odd_y * (y * y - 1)
    return np.asarray(density * (corner.correlation + cumulants), dtype=np.float32)


def _binormal(r: Float, x: Float, y: Float) -> Float:
    """The density of two standard normal variables with correlation r, at x, y."""
    rest = 1 - r * r
    scale = np.float32(2 * np.pi) * np.sqrt(rest)
    return np.asarray(np.exp((x * x + y * y - 2 * r * x * y) / (-2 * rest)) / scale, dtype=np.float32)


def _sum(level: Float, steps: Float, base: Index, spread: list[Float]) -> Float:
    """`T_0 + Σ_k T_k S_k` (P,), tables of T read from `base` on."""
    # All indices are within: wrapping never happens, and is faster than to check that.
    total = level.take(base, mode="wrap")
    for k, along in enumerate(spread):
        total += steps[k:].take(base, mode="wrap") * along
    return total
