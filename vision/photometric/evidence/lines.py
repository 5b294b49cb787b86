"""Readings of candidates that a line crosses: a pen stroke, a cable, a scratch, a row of dead pixels.

A line shows nothing of the marker. It is as dark as black or as bright as white from one end of the readings
to the other. The bits beside it decide, and those that it covers do not count.

With f the density of a reading y about a level, outliers included (`pattern_fit.densities`), the log
likelihood ratio of a line of level l is the sum of `log f(y - l) - log f(y - pattern)` over its parts. Bits
by chance have no such line: it would also have to cross cells of the other colour, and the white zone on
either side.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.vision.native.pattern_records import PARTS
from skyherd.vision.native.records import Floats
from skyherd.vision.photometric.evidence.pattern_fit import columns_of, densities, fit_patterns, whiteness
from skyherd.vision.photometric.evidence.readings import Readings, nearest_patterns, part_places

DIRECTIONS, STEP_PARTS, WIDTHS_PARTS = 24, 0.5, (1.0, 2.0, 3.0)
"""Directions of lines, steps between them, and their widths. Chosen: neighbouring lines overlap by half of
the smallest width, and none is wider than a cell, whose bit it would replace."""

HALO_PARTS = 0.5
"""Distance from a line up to which parts do not count either. Chosen: blur carries a line as far."""

MIN_LOG_RATIO = 12.0
"""Smallest log likelihood ratio of a code with a line to the likeliest code without one. Derived: 9 is the
logarithm of the number of lines that are tried; a factor of 20 is their prior. Measured on 192 markers of
4X4_50 under pen lines of 2 and 3 px (tuning seeds): 164 are found, with 10 one more, with 16 four fewer."""

LEVELS = 0.0, 1.0
"""Whiteness of lines. Chosen: ink, cables and dead pixels are black, scratches and paper white."""

LINE_STD, OWN_DIFFERENCE = 0.1, 0.25
"""Standard deviation of parts under a line about its level, and the difference of that to the pattern from
which on a part counts, shares of the contrast. Chosen: ink is greyer than print, and parts are covered in
part; what is black already says nothing of a black line."""

CODES = 2
"""Codes whose patterns are compared with lines. Chosen: under one line the right one is among them."""


def without_line(readings: Readings, dictionary: str) -> tuple[Readings, BoolArray]:
    """Return the readings of N candidates without the likeliest line, and which (N,) have one."""
    ratios = _log_ratios(readings, nearest_patterns(readings, dictionary, CODES))
    lines, best = _lines(readings.n_cells), ratios.argmax(axis=1)
    has_line = ratios[np.arange(len(best)), best] > MIN_LOG_RATIO
    return readings.unseen(lines.covered(best % lines.count) & has_line[:, None]), has_line


def _log_ratios(readings: Readings, patterns: Array) -> Array:
    """Return the log likelihood ratios of each pattern (N, K, parts) with each line of either level.

    The result has N rows, for each pattern, level and line, in this order.
    """
    fits, lines = fit_patterns(readings, patterns), _lines(readings.n_cells)
    priors, weights = columns_of(readings.n_cells).outlier_priors, readings.weights[:, None] * readings.seen
    has_contrast = np.isfinite(fits.logs)
    logs = np.where(has_contrast, fits.logs, np.finfo(float).min)
    of_parts, offsets = [], []
    for code, pattern in enumerate(np.moveaxis(patterns, 1, 0)):
        white, contrasts = whiteness(readings, fits, np.full(len(patterns), code))
        shares = contrasts / readings.scales[:, None]
        own = np.log(densities((white - pattern) * shares, fits.stds[:, code, None], priors)[1])
        for level in LEVELS:
            line = np.log(densities((white - level) * shares, LINE_STD * shares, priors)[1])
            differs = np.abs(pattern - level) > OWN_DIFFERENCE
            of_parts.append(weights * differs * (line - own))
            offsets.append(np.where(has_contrast[:, code], logs[:, code] - logs.max(axis=1), -np.inf))
    ratios = lines.sums(np.stack(of_parts, axis=1)) + np.stack(offsets, axis=1)[..., None]
    return np.asarray(ratios.reshape(len(patterns), -1))


@dataclass(frozen=True)
class _Lines:
    """Lines of D directions, each with L offsets and widths, over the parts of a candidate.

    Attributes:
        places: (D, parts) of parts across the lines, parts from the centre.
        offsets: (L,) of the lines, parts from the centre.
        widths: (L,) of the lines, parts.
        covers: (parts, D L) 1 for the parts that each line covers, else 0.
    """

    places: Array
    offsets: Array
    widths: Array
    covers: Floats

    @property
    def count(self) -> int:
        """Number of lines, D L."""
        return len(self.places) * self.offsets.size

    def sums(self, values: Array) -> Array:
        """Return the sums (..., D L) of values (..., parts) over each line."""
        rows = values.reshape(-1, values.shape[-1]).astype(np.float32) @ self.covers
        return rows.reshape(*values.shape[:-1], self.count).astype(float)

    def covered(self, lines: IntArray) -> BoolArray:
        """Return the parts (N, parts) that each of N lines covers, with its halo."""
        direction, number = np.divmod(lines, self.offsets.size)
        away = np.abs(self.places[direction] - self.offsets[number, None])
        return np.asarray(away <= self.widths[number, None] / 2 + HALO_PARTS)


@lru_cache(maxsize=16)
def _lines(n_cells: int) -> _Lines:
    """Return all lines whose middle crosses a marker of n cells a side."""
    at, reach = PARTS * (part_places(n_cells) - n_cells / 2), PARTS * n_cells / 2
    angles = np.pi / DIRECTIONS * np.arange(DIRECTIONS)
    places = (np.cos(angles)[:, None, None] * at + np.sin(angles)[:, None, None] * at[:, None]).reshape(
        DIRECTIONS, -1
    )
    steps = np.arange(-reach, reach + STEP_PARTS / 2, STEP_PARTS)
    offsets, widths = (part.ravel() for part in np.meshgrid(steps, WIDTHS_PARTS))
    covers = np.empty((places.shape[1], DIRECTIONS, len(WIDTHS_PARTS), steps.size), dtype=np.float32)
    for direction, across in enumerate(places):
        away = np.abs(across[:, None] - steps)
        for number, width in enumerate(WIDTHS_PARTS):
            covers[:, direction, number] = away <= width / 2
    return _Lines(places, offsets, widths, covers.reshape(len(covers), -1))
