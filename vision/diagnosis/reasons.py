"""Why a candidate is no detection: at which stage of the detector it is lost, by which limit, and what to do.

The stages are those of `skyherd.vision.photometric.detector`: the search for an outline, the decoding of its
cells, the fit, and the tests that verify it (`skyherd.vision.photometric.verify`).
"""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from skyherd.geometry import Array
from skyherd.vision.diagnosis.reading import Reading
from skyherd.vision.photometric.verify import FitTest, Quantity
from skyherd.vision.search.quads import MIN_QUAD_SIDE_PX
from skyherd.vision.search.regions import DARKER

MIN_SIDE_PX = MIN_QUAD_SIDE_PX + 1.0
"""Smallest side of a marker that the search looks for, px. Derived: `MIN_QUAD_SIDE_PX` is between the centres
of the outermost pixels, which are half a pixel inside of the edges."""

MIN_SEARCHED_CONTRAST = 3.0 * DARKER
"""Contrast, grey levels, below which the search may see no outline. Derived: it takes what is darker than the
mean around it by `DARKER`, and that mean lies half-way at an edge. Chosen: half as much again, for blur and
noise."""

QUIET_SHARE = 0.4
"""A quiet zone must lie at least this share of the way from black to white on every side. Chosen: a little
less than half, since blur darkens a narrow zone."""

MARKER_LIKE = 0.6
"""Likeness of a clear frame below which its content is not taken as bits. Chosen: below a marker with several
wrong cells, above most other drawings."""

MIN_ODDS_OF_BITS = 2.0
"""Log odds of a marker from which on a candidate is explained, whatever else it lacks. Chosen: markers that
photographs show badly have 2.4 to 9, and one in thirty photographs has clutter of 0 to 1."""

CERTAIN = 0.94
"""Likeness of what is plainly a marker. Small or faint candidates have to reach it, since chance is like some
marker too. Measured: markers that are too small or too blurred have 0.945 or more, and what is none on
photographs up to 0.938."""

LEGIBLE_BLUR_CELLS = 0.6
"""Blur, cells, beyond which what is not found counts as too blurred, whatever else it lacks: its outline is
rounded then, and its cells are read in the wrong places. Measured of markers of 10 to 12 px at noise 2: all
are found up to 0.64 cells, nine in ten at 0.72, and none from 0.77 cells on."""

SHARP_BLUR_PX = 1.2
"""Blur, px, up to which an image is sharp, so that a marker that it blurs is too small. Chosen: twice that of
usual photographs."""

CLEAR_CELL_PX, CLEAR_CONTRAST, CLEAR_BLUR_CELLS = 3.0, 40.0, 0.55
"""Smallest cell, px, smallest contrast, grey levels, and largest blur, cells, of a clear frame. Chosen: what
is in it can then be told from bits, however unlike a marker it is."""

MIN_CONTRAST = 8.0
"""Difference of white and black, grey levels, that bits must exceed. Chosen: above the usual noise of 3."""

BIT_SHARE = 0.3
"""Share of the step from the border to the surroundings that the contrast of bits must exceed. Chosen: a
white cell is as bright as the card apart from blur."""

MIN_QUIET_CONTRAST = 1.0
"""Smallest contrast, grey levels, that the quiet zone's level is compared with, so that none divides by
zero."""


class Reason(Enum):
    """Why a candidate is no detection; the values are the words that users read."""

    REPEATED = "id seen twice"
    OVERLOOKED = "found by photometric"
    NO_BITS = "no bits"
    MIRRORED = "mirrored"
    WRONG_BITS = "bits wrong"
    FEW_PIXELS = "too few pixels"
    NO_QUIET_ZONE = "no quiet zone"
    NO_OUTLINE = "no outline"
    LOW_CONTRAST = "low contrast"
    TOO_WHITE = "white too bright"
    BLURRED = "too blurred"
    CUT = "cut by the border"
    PART = "perhaps a part of another"
    OBLIQUE = "too oblique"
    TOO_NEAR = "too near at a slant"
    NOISY = "too noisy"
    UNSETTLED = "fit not settled"
    WRONG_CELL = "a cell doubtful"
    UNLIKE_PIXELS = "pixels unlike the marker"
    UNLIKE_CELLS = "cells unlike the marker"
    PALE_PRINT = "paler than the others"


OF_QUANTITY = {
    Quantity.CONTRAST: Reason.LOW_CONTRAST,
    Quantity.WHITE: Reason.TOO_WHITE,
    Quantity.BLUR: Reason.BLURRED,
    Quantity.AREA: Reason.CUT,
    Quantity.ANISOTROPY: Reason.OBLIQUE,
    Quantity.KEYSTONE: Reason.TOO_NEAR,
    Quantity.CELL_NOISE: Reason.NOISY,
    Quantity.LAST_STEP: Reason.UNSETTLED,
    Quantity.WORST_CELL: Reason.WRONG_CELL,
    Quantity.PIXEL_RESIDUAL: Reason.UNLIKE_PIXELS,
    Quantity.CELL_RESIDUAL: Reason.UNLIKE_CELLS,
    Quantity.PRINT_CONTRAST: Reason.PALE_PRINT,
}
"""What a failed test of a fit means."""


SPOILED_BY_GROUND = {
    Quantity.WORST_CELL,
    Quantity.LAST_STEP,
    Quantity.CELL_NOISE,
    Quantity.PIXEL_RESIDUAL,
    Quantity.CELL_RESIDUAL,
}
"""Tests that a fit fails where dark ground takes the place of the white margin, which it expects."""


@dataclass(frozen=True)
class Measured:
    """A quantity of one candidate and its limit.

    Attributes:
        name: of the quantity, with its unit.
        value: of this candidate.
        limit: largest value that passes, or smallest one.
        at_least: whether the limit is the smallest value that passes.
    """

    name: str
    value: float
    limit: float
    at_least: bool = False

    def __str__(self) -> str:
        allowed = "at least" if self.at_least else "at most"
        return f"{self.name} {self.value:.3g}, {allowed} {self.limit:.3g}"


@dataclass(frozen=True)
class Suspect:
    """A possible marker, and the stage that the detector reached with it.

    Attributes:
        reading: of it, by correlation with all markers.
        seen: whether the search found its outline.
        fitted: whether its cells were decoded and a marker was fitted to it.
        good: whether the fit is verified.
        failed: the first test that the fit fails; None without a fit, or if it fails none.
        log_odds: natural logarithm of the odds that it is a marker; -inf if that is hopeless.
        is_part: whether it may be the part of a marker that the border cuts.
    """

    reading: Reading
    seen: bool
    fitted: bool = False
    good: bool = False
    failed: tuple[Quantity, Measured] | None = None
    log_odds: float = -math.inf
    is_part: bool = False


def failed_test(tests: list[FitTest], row: int) -> tuple[Quantity, Measured] | None:
    """Return the first of a fit's tests that it fails, with value and limit; None if it passes all."""
    for test in tests:
        if not test.passed()[row]:
            limit = float(np.broadcast_to(test.limits, test.values.shape)[row])
            name = UNITS[test.quantity]
            return test.quantity, Measured(name, float(test.values[row]), limit, test.at_least)
    return None


UNITS = {
    Quantity.CONTRAST: "contrast in grey levels",
    Quantity.WHITE: "white in grey levels",
    Quantity.BLUR: "blur in cells",
    Quantity.AREA: "share of its area in the image",
    Quantity.ANISOTROPY: "anisotropy",
    Quantity.KEYSTONE: "keystone",
    Quantity.CELL_NOISE: "noise of a cell",
    Quantity.LAST_STEP: "last step in px",
    Quantity.WORST_CELL: "worst cell as a share of a wrong one",
    Quantity.PIXEL_RESIDUAL: "residual of the pixels in grey levels",
    Quantity.CELL_RESIDUAL: "residual of the cells in grey levels",
    Quantity.PRINT_CONTRAST: "print contrast",
}
"""Names of the quantities with their units, as users read them."""


def find_reason(suspect: Suspect, *, again: bool) -> tuple[Reason, Measured | None]:
    """Return why a suspect is no detection, and the quantity that says so, if one does.

    Args:
        suspect: the candidate.
        again: whether its id is there without a fault elsewhere too.
    """
    reading = suspect.reading
    exact = reading.wrong_bits == 0 and reading.likeness >= CERTAIN
    if (suspect.good or exact) and again and not reading.mirrored:
        return Reason.REPEATED, None
    if suspect.good:
        return Reason.OVERLOOKED, None
    if not _has_bits(reading, suspect.log_odds):
        return Reason.NO_BITS, Measured("likeness", reading.likeness, CERTAIN, at_least=True)
    if exact and reading.mirrored:
        return Reason.MIRRORED, None
    if reading.side_px < MIN_SIDE_PX:
        return Reason.FEW_PIXELS, Measured("side in px", reading.side_px, MIN_SIDE_PX, at_least=True)
    if reading.blur_cells > LEGIBLE_BLUR_CELLS and reading.likeness >= CERTAIN:
        if reading.blur_cells * float(reading.cell_px.mean()) <= SHARP_BLUR_PX:
            legible_px = reading.side_px * reading.blur_cells / LEGIBLE_BLUR_CELLS
            return Reason.FEW_PIXELS, Measured("side in px", reading.side_px, legible_px, at_least=True)
        return Reason.BLURRED, Measured(UNITS[Quantity.BLUR], reading.blur_cells, LEGIBLE_BLUR_CELLS)
    if not suspect.seen:
        return _unseen_reason(suspect)
    dark = int(edges_without_quiet(reading).sum())
    if dark and not reading.wrong_bits and suspect.failed and suspect.failed[0] in SPOILED_BY_GROUND:
        return Reason.NO_QUIET_ZONE, Measured("edges without a white margin", dark, 0.0)
    if reading.wrong_bits and (not suspect.fitted or _is_cell(suspect.failed)):
        return Reason.WRONG_BITS, Measured("wrong cells", reading.wrong_bits, 0.0)
    if suspect.is_part and suspect.failed is None:
        return Reason.PART, None
    return _test_reason(suspect.failed)


def _unseen_reason(suspect: Suspect) -> tuple[Reason, Measured | None]:
    """Why the search finds no outline around what reads as a marker."""
    reading = suspect.reading
    if reading.contrast < MIN_SEARCHED_CONTRAST and suspect.failed is None:
        name = UNITS[Quantity.CONTRAST]
        return Reason.LOW_CONTRAST, Measured(name, reading.contrast, MIN_SEARCHED_CONTRAST, at_least=True)
    dark = int(edges_without_quiet(reading).sum())
    if dark:
        return Reason.NO_QUIET_ZONE, Measured("edges without a white margin", dark, 0.0)
    if reading.wrong_bits:
        return Reason.WRONG_BITS, Measured("wrong cells", reading.wrong_bits, 0.0)
    if reading.visible < 1 and suspect.failed is None:
        return Reason.CUT, Measured("share of its cells in the image", reading.visible, 1.0, at_least=True)
    return _test_reason(suspect.failed)


def _test_reason(failed: tuple[Quantity, Measured] | None) -> tuple[Reason, Measured | None]:
    return (Reason.NO_OUTLINE, None) if failed is None else (OF_QUANTITY[failed[0]], failed[1])


def _is_cell(failed: tuple[Quantity, Measured] | None) -> bool:
    return failed is not None and failed[0] is Quantity.WORST_CELL


def _has_bits(reading: Reading, log_odds: float) -> bool:
    """Return whether it may be a marker by log odds or likeness, or is a clear frame with something in."""
    if log_odds > MIN_ODDS_OF_BITS:
        return True
    if reading.contrast <= max(MIN_CONTRAST, BIT_SHARE * reading.depth):
        return False
    return reading.likeness >= (MARKER_LIKE if is_clear(reading) else CERTAIN)


def is_clear(reading: Reading) -> bool:
    """Return whether a candidate is a large, sharp and clear frame on white."""
    clear = reading.framed and reading.cell_px[0] >= CLEAR_CELL_PX and reading.contrast >= CLEAR_CONTRAST
    return clear and reading.blur_cells <= CLEAR_BLUR_CELLS and not bool(edges_without_quiet(reading).any())


def edges_without_quiet(reading: Reading) -> Array:
    """(4,) whether the quiet zone beside each edge is too dark."""
    share = (reading.quiet - reading.black) / max(reading.contrast, MIN_QUIET_CONTRAST)
    return np.asarray(share < QUIET_SHARE)
