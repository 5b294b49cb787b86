"""Records and structures of the fits of patterns that the compiled library shares with Python."""

import ctypes
from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array
from skyherd.native.arguments import address
from skyherd.vision.native.records import Floats

PARTS = 3
"""Parts of a cell along its side, as `PARTS` in `pattern_fit.h`. Chosen: two miss edges that lie within a
cell, four take twice the time."""


class PatternConstants(ctypes.Structure):
    """Constants of the fit of patterns, as `PatternConstants` in `pattern_fit.h`; see `pattern_fit.py`."""

    _fields_ = (
        *(
            (name, ctypes.c_double)
            for name in (
                *("card_outliers", "zone_outliers", "outlier_range", "first_zone_share"),
                *("usual_std", "usual_std_parts", "first_std", "gradient_std", "log_contrast_std"),
                *("rounding_std", "ridge", "min_contrast"),
            )
        ),
        ("iterations", ctypes.c_int64),
    )


class PatternRequestStructure(ctypes.Structure):
    """Readings and patterns; `PatternRequest` in `pattern_fit.h` has the same fields."""

    _fields_ = (
        ("levels", ctypes.c_void_p),
        ("seen", ctypes.c_void_p),
        ("scales", ctypes.c_void_p),
        ("weights", ctypes.c_void_p),
        ("ranges", ctypes.c_void_p),
        ("patterns", ctypes.c_void_p),
        ("ground_shares", ctypes.c_void_p),
        ("constants", ctypes.POINTER(PatternConstants)),
        ("count", ctypes.c_int64),
        ("each", ctypes.c_int64),
        ("grounds", ctypes.c_int64),
        ("n", ctypes.c_int32),
        ("any_contrast", ctypes.c_int32),
    )


@dataclass(frozen=True)
class PatternRequest:
    """Readings of N candidates in parts of cells, and K patterns for each of them.

    Attributes:
        levels: (N, parts) grey levels.
        seen: (N, parts) 0 where glare saturates a part, else 1.
        scales: (N,) range of the readings, grey levels.
        weights: (N,) independent readings that a part counts as.
        ranges: (N,) range that the contrast should explain, grey levels.
        patterns: (N, K, parts) whiteness, 0 to 1.
        grounds: (N or 1, parts) share of a ground with a level of its own, or None.
        constants: of the fit.
        n_cells: cells along a marker's side, n; there are `(PARTS (n + 2))²` parts.
        any_contrast: whether the contrast need not explain the range.
    """

    levels: Floats
    seen: Floats
    scales: Array
    weights: Array
    ranges: Array
    patterns: Floats
    grounds: Floats | None
    constants: PatternConstants
    n_cells: int
    any_contrast: bool

    def structure(self) -> PatternRequestStructure:
        """Return the structure of the request, which is valid as long as its arrays.

        Raises:
            InputError: an array has another type, shape or memory layout.
        """
        (count, each), parts = self.patterns.shape[:2], (PARTS * (self.n_cells + 2)) ** 2
        grounds = 0 if self.grounds is None else len(self.grounds)
        return PatternRequestStructure(
            address("levels", self.levels, np.float32, (count, parts)),
            address("seen", self.seen, np.float32, (count, parts)),
            address("scales", self.scales, np.float64, (count,)),
            address("weights", self.weights, np.float64, (count,)),
            address("ranges", self.ranges, np.float64, (count,)),
            address("patterns", self.patterns, np.float32, (count, each, parts)),
            None if grounds == 0 else address("grounds", self.grounds, np.float32, (grounds, parts)),
            ctypes.pointer(self.constants),
            count,
            each,
            grounds,
            self.n_cells,
            self.any_contrast,
        )


PATTERN_FIT = np.dtype([("logs", float), ("levels", float, (6,)), ("stds", float), ("outlier_shares", float)])
"""Record of a fit, as `PatternFit` in `pattern_fit.h`."""
