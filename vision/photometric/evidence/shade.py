"""Readings of candidates across which a shadow's edge runs, brought to one light.

A shadow multiplies the light beyond its edge by a factor λ. Under a pattern of whiteness w the readings are
`b + c w` on one side of a line, and `λ (b + c w)` on the other. For each of many lines, b, c and λ
follow from sums over both sides, by least squares. The line that leaves the least is taken, and the
readings beyond it are divided by its λ.
"""

import numpy as np

from skyherd.geometry import Array, BoolArray
from skyherd.vision.photometric.evidence.readings import Readings, nearest_patterns, part_places


def _pairs(directions: Array, distances: Array) -> Array:
    """Return all pairs (K, 2) of directions and distances."""
    return np.stack(np.meshgrid(directions, distances), axis=-1).reshape(-1, 2)


FIRST_LINES = _pairs(np.linspace(0, 2 * np.pi, 16, endpoint=False), np.linspace(-0.45, 0.45, 10))
"""Lines that are tried first: the direction in which each is crossed, rad, and its distance from the centre,
sides. Chosen: one of them misses an edge by less than a cell of 4X4_50."""

FINER_CHANGES = _pairs(np.linspace(-0.2, 0.2, 5), np.linspace(-0.08, 0.08, 5))
"""Changes of the best line that are tried then: of its direction, rad, and of its distance, sides. Chosen:
half of the steps above to either side, in steps of a part."""

BAND_SIDES = 0.05
"""Distance from the line, in sides, up to which parts may lie on either side of it. Chosen: the size of a
part."""

CODES = 3
"""Codes whose patterns are tried with all lines. Chosen: under a shadow the right one is among them."""

ROUNDS = 4
"""Rounds of least squares: each estimates the levels, and then the factor. Chosen: the factor has settled."""

MIN_FACTOR, MAX_FACTOR = 0.1, 0.85
"""Limits of λ, of the darker side. Chosen: a darker shadow leaves no contrast, a lighter one is explained as
outliers."""

MIN_SUM = 1e-9
"""Smallest sum that is divided by."""


def without_shade(readings: Readings, dictionary: str) -> tuple[Readings, BoolArray]:
    """Return the readings of N candidates with the light beyond one line brought to that before it.

    They are left as they are where the factor of the best line is beyond its limits. Also returned is which
    (N,) have changed.
    """
    white = nearest_patterns(readings, dictionary, CODES)
    rows, n_cells = np.arange(len(white)), readings.n_cells
    left, _ = _fit_lines(readings, white, _distances_from_lines(n_cells, FIRST_LINES))
    code, line = np.divmod(left.reshape(len(white), -1).argmin(axis=1), len(FIRST_LINES))
    white = white[rows, code][:, None]
    lines = FIRST_LINES[line][:, None] + FINER_CHANGES
    left, _ = _fit_lines(readings, white, _distances_from_lines(n_cells, lines))
    best = left[:, 0].argmin(axis=1)
    distances = _distances_from_lines(n_cells, lines[rows, best][:, None])
    _, factors = _fit_lines(readings, white, distances, BAND_SIDES)
    has_edge = np.isfinite(left[rows, 0, best])[:, None] & (factors[:, 0] > MIN_FACTOR)
    is_shaded = has_edge & (distances[:, 0] > 0)
    levels = np.where(is_shaded, readings.levels / factors[:, 0], readings.levels)
    return readings.with_levels(levels), is_shaded.any(axis=1)


def _distances_from_lines(n_cells: int, lines: Array) -> Array:
    """Return the distances (..., parts) of parts from lines (..., 2), in sides, positive beyond them.

    A line has the direction in which it is crossed, rad, and its distance from the centre, sides.
    """
    at = part_places(n_cells) / n_cells - 0.5
    angles, offsets = lines[..., 0, None, None], lines[..., 1, None, None]
    along = np.cos(angles) * at + np.sin(angles) * at[:, None] - offsets
    return np.asarray(along.reshape(*lines.shape[:-1], -1))


def _fit_lines(
    readings: Readings, white: Array, distances: Array, band_sides: float = 0.0
) -> tuple[Array, Array]:
    """Return the sums (N, K, L) of squared errors under each line, and the factors λ (N, K, L).

    The sums are infinite for factors beyond their limits.

    Args:
        readings: of N candidates.
        white: (N, K, parts) whiteness of K patterns for each.
        distances: (L, parts) or (N, L, parts) of parts beyond each line, sides.
        band_sides: distance up to which parts do not count, sides.
    """
    seen, y = readings.seen[:, None], readings.levels[:, None]
    of_parts = np.stack(
        [np.broadcast_to(part, white.shape) for part in (seen, seen * y, seen * y**2)]
        + [seen * white, seen * white**2, seen * y * white]
    ).astype(np.float32)
    sides = (distances < -band_sides, distances > band_sides)
    near, far = (of_parts @ side.swapaxes(-1, -2).astype(np.float32) for side in sides)
    factor = np.ones(near.shape[1:])
    for _ in range(ROUNDS):
        ones, first, squares, whites, both, second = near
        n, v, _, w, ww, vw = far
        ones, whites, both = ones + factor**2 * n, whites + factor**2 * w, both + factor**2 * ww
        first, second = first + factor * v, second + factor * vw
        area = np.maximum(ones * both - whites**2, MIN_SUM)
        black, contrast = (both * first - whites * second) / area, (ones * second - whites * first) / area
        power = black**2 * n + 2 * black * contrast * w + contrast**2 * ww
        factor = np.clip((black * v + contrast * vw) / np.maximum(power, MIN_SUM), MIN_FACTOR, 1.0)
    left = squares + far[2] - black * first - contrast * second
    return np.where((factor > MIN_FACTOR) & (factor < MAX_FACTOR), left, np.inf), factor
