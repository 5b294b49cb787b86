"""Why a candidate is no detection: the stage of the detector that refuses it, by which limit, and what to do.

The stages are those of `skyherd.vision.photometric.detector`: the search for an outline, the decoding of its
cells, the fit, the tests that verify it (`skyherd.vision.photometric.verify`), and the log odds of a marker.
"""

from dataclasses import dataclass
from enum import Enum, IntEnum

import numpy as np

from skyherd.markers.dictionary import cells_per_side
from skyherd.vision.diagnosis.reading import Reading
from skyherd.vision.photometric.verify import FitTest, Quantity
from skyherd.vision.search.quads import MIN_QUAD_SIDE_PX

MIN_SIDE_PX = MIN_QUAD_SIDE_PX + 1.0
"""Smallest side of a marker that the search looks for, px. Derived: `MIN_QUAD_SIDE_PX` is between the centres
of the outermost pixels, which are half a pixel inside of the edges."""

MIN_ODDS_OF_BITS = 2.0
"""Log odds of a marker from which on a candidate is explained, whatever else it lacks. Chosen: markers that
photographs show badly have 2.4 to 9, and one in thirty photographs has clutter of 0 to 1."""

MARKER_LIKE, CERTAIN = 0.6, 0.94
"""Likeness below which the content of a clear frame is not taken as bits, and that of what is plainly a
marker. Chosen: below a marker with several wrong cells, above most other drawings. Measured: markers that are
too small or too blurred have 0.945 or more, and what is none on photographs up to 0.938."""

LEGIBLE_BLUR_CELLS = 0.6
"""Blur, cells, beyond which what is not found counts as too blurred, whatever else it lacks: its outline is
rounded then, and its cells are read in the wrong places. Measured of markers of 10 to 12 px at noise 2: all
are found up to 0.64 cells, nine in ten at 0.72, and none from 0.77 cells on."""

SHARP_BLUR_PX = 1.2
"""Blur, px, up to which an image is sharp, so that a marker that it blurs is too small. Chosen: twice that of
usual photographs."""

CLEAR_CELL_PX, CLEAR_CONTRAST, CLEAR_BLUR_CELLS = 3.0, 40.0, 0.5
"""Smallest cell, px, smallest contrast, grey levels, and largest blur, cells, of a clear frame. Chosen: what
is in it can then be told from bits, however unlike a marker it is. Measured: of 813 dark quadrilaterals on
texture none passes; one does with a blur of 0.55."""

SHOWN_CELLS = 4
"""Most wrong cells that are named one by one. Chosen: they fit into a line."""


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


FAILED = {
    Quantity.CELL_SIZE: (Reason.FEW_PIXELS, "cell in px"),
    Quantity.CONTRAST: (Reason.LOW_CONTRAST, "contrast in grey levels"),
    Quantity.WHITE: (Reason.TOO_WHITE, "white in grey levels"),
    Quantity.BLUR: (Reason.BLURRED, "blur in cells"),
    Quantity.AREA: (Reason.CUT, "share of its area in the image"),
    Quantity.ANISOTROPY: (Reason.OBLIQUE, "anisotropy"),
    Quantity.KEYSTONE: (Reason.TOO_NEAR, "keystone"),
    Quantity.CELL_NOISE: (Reason.NOISY, "noise of a cell"),
    Quantity.LAST_STEP: (Reason.UNSETTLED, "last step in px"),
    Quantity.WORST_CELL: (Reason.WRONG_CELL, "worst cell as a share of a wrong one"),
    Quantity.PIXEL_RESIDUAL: (Reason.UNLIKE_PIXELS, "residual of the pixels in grey levels"),
    Quantity.CELL_RESIDUAL: (Reason.UNLIKE_CELLS, "residual of the cells in grey levels"),
    Quantity.PRINT_CONTRAST: (Reason.PALE_PRINT, "print contrast"),
}
"""What a failed test of a fit means, and the name of its quantity with the unit."""

OF_PATTERN = {
    Quantity.WORST_CELL,
    Quantity.LAST_STEP,
    Quantity.CELL_NOISE,
    Quantity.PIXEL_RESIDUAL,
    Quantity.CELL_RESIDUAL,
}
"""Tests that a fit fails where dark ground takes the place of the white margin, or cells are wrong."""

WORDS = {
    Reason.REPEATED: "id {id} is there more than once, so that none is trusted: use each id once, or report "
    "all of them with `repeats=True`",
    Reason.OVERLOOKED: "the detector photometric finds id {id} here: use it",
    Reason.NO_BITS: "a dark quadrilateral without bits",
    Reason.MIRRORED: "the mirror image of id {id}: flip the picture left to right",
    Reason.WRONG_BITS: "{wrong} of {cells} cells differ from the nearest marker, id {id} (row.column "
    "{which}): covered or shaded in part, dirty, or of another dictionary than {dictionary}",
    Reason.FEW_PIXELS: "{measured} ({like}): fly lower, zoom in or print larger",
    Reason.NO_QUIET_ZONE: "no white margin at {dark_edges} of its 4 edges ({like}): leave one cell, "
    "{cell_percent:.0f} % of its side, white all around",
    Reason.NO_OUTLINE: "no dark square with four straight sides is found around it ({like}): keep "
    "away what crosses or touches its border",
    Reason.LOW_CONTRAST: "{measured} ({like}): more light, less glare, a better print",
    Reason.TOO_WHITE: "{measured} ({like}): expose for less time, or less glare",
    Reason.BLURRED: "{measured} ({like}): focus, expose for less time, or print larger",
    Reason.CUT: "{measured} ({like}): all of it must be in the picture, with its white margin",
    Reason.PART: "half of a marker that the border cuts looks the same ({like}): all of it must be in the "
    "picture, and a marker seen at a slant farther from the border",
    Reason.OBLIQUE: "{measured}, seen at {tilt_deg:.0f} deg ({like}): look from nearer to straight above",
    Reason.TOO_NEAR: "{measured} ({like}): look from farther away, or from nearer to straight above",
    Reason.NOISY: "{measured} ({like}): more light, fly lower or print larger",
    Reason.UNSETTLED: "{measured} ({like}): something that looks like part of it is beside it, or it is bent",
    Reason.WRONG_CELL: "{measured} ({like}): covered or shaded in part, dirty, of another dictionary than "
    "{dictionary}, or too much sharpening and compression",
    Reason.UNLIKE_PIXELS: "{measured} ({like}): bent, covered in part, glare, or too much sharpening and "
    "compression",
    Reason.UNLIKE_CELLS: "{measured} ({like}): glare or shade across it, or covered in part",
    Reason.PALE_PRINT: "{measured} ({like}): print all markers alike, without glare",
}
"""What users read for each reason, with places for the numbers that `describe` fills in."""


class Stage(IntEnum):
    """The result of the detector for a candidate."""

    ACCEPTED = 0  # as a marker
    PART = 1  # refused only as it may be the part of a marker that the border cuts
    FITTED = 2  # and refused by its fit and its log odds
    DECODED = 3  # and not clear enough to be fitted
    UNSEEN = 4  # a dark region without an outline
    CUT = 5  # by the image's border
    MIRRORED = 6  # the mirror image of a marker


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


def failed_test(tests: list[FitTest], row: int) -> tuple[Quantity, Measured] | None:
    """Return the first of a fit's tests that it fails, with value and limit; None if it passes all."""
    for test in tests:
        if not test.passed()[row]:
            limit = float(np.broadcast_to(test.limits, test.values.shape)[row])
            name = FAILED[test.quantity][1]
            return test.quantity, Measured(name, float(test.values[row]), limit, test.at_least)
    return None


def find_reason(
    reading: Reading, stage: Stage, failed: tuple[Quantity, Measured] | None, log_odds: float, *, again: bool
) -> tuple[Reason, Measured | None]:
    """Return why a candidate is no detection, and the quantity that says so, if one does.

    Args:
        reading: of its cells.
        stage: the result of the detector.
        failed: the first test that its fit fails; None if it fails none.
        log_odds: natural logarithm of the odds that it is a marker; -inf if that is hopeless.
        again: whether its id is accepted elsewhere too.
    """
    quantity, value = failed or (None, None)
    if stage is Stage.ACCEPTED:
        return Reason.REPEATED if again else Reason.OVERLOOKED, None
    if stage is Stage.MIRRORED:
        return Reason.MIRRORED, None
    if stage is Stage.PART and failed is None:
        return Reason.PART, None
    if stage is Stage.CUT:
        share = Measured("share of its cells in the image", reading.visible, 1.0, at_least=True)
        return Reason.CUT, value if quantity is Quantity.AREA else share
    if not _has_bits(reading, log_odds):
        return Reason.NO_BITS, Measured("likeness", reading.likeness, CERTAIN, at_least=True)
    if reading.side_px < MIN_SIDE_PX:
        return Reason.FEW_PIXELS, Measured("side in px", reading.side_px, MIN_SIDE_PX, at_least=True)
    if reading.blur_cells > LEGIBLE_BLUR_CELLS and reading.likeness >= CERTAIN:
        if reading.blur_cells * float(reading.cell_px.mean()) <= SHARP_BLUR_PX:
            legible_px = reading.side_px * reading.blur_cells / LEGIBLE_BLUR_CELLS
            return Reason.FEW_PIXELS, Measured("side in px", reading.side_px, legible_px, at_least=True)
        return Reason.BLURRED, Measured(FAILED[Quantity.BLUR][1], reading.blur_cells, LEGIBLE_BLUR_CELLS)
    if quantity is None or quantity in OF_PATTERN or stage is Stage.DECODED:
        if reading.wrong_cells:
            return Reason.WRONG_BITS, Measured("wrong cells", len(reading.wrong_cells), 0.0)
        if reading.dark_edges:
            return Reason.NO_QUIET_ZONE, Measured("edges without a white margin", reading.dark_edges, 0.0)
    return (Reason.NO_OUTLINE, None) if quantity is None else (FAILED[quantity][0], value)


def _has_bits(reading: Reading, log_odds: float) -> bool:
    """Return whether it may be a marker by log odds or likeness, or is a clear frame with something in."""
    clear = reading.has_frame and not reading.dark_edges and reading.blur_cells <= CLEAR_BLUR_CELLS
    clear &= bool(reading.cell_px[0] >= CLEAR_CELL_PX and reading.contrast >= CLEAR_CONTRAST)
    return log_odds > MIN_ODDS_OF_BITS or reading.likeness >= (MARKER_LIKE if clear else CERTAIN)


def describe(reason: Reason, measured: Measured | None, reading: Reading, dictionary: str) -> str:
    """Return the reason with the numbers that were measured, and what to do about it, in words."""
    n, wrong = cells_per_side(dictionary), reading.wrong_cells
    like = f"most like id {reading.nearest_id}"
    if wrong:
        like += f", {len(wrong)} of {n * n} cells wrong"
    which = ", ".join(f"{row}.{column}" for row, column in wrong[:SHOWN_CELLS])
    return WORDS[reason].format(
        measured=measured,
        like=like,
        id=reading.nearest_id,
        wrong=len(wrong),
        which=which + (", …" if len(wrong) > SHOWN_CELLS else ""),
        cells=n * n,
        cell_percent=100 / n,
        tilt_deg=reading.tilt_deg,
        dark_edges=reading.dark_edges,
        dictionary=dictionary,
    )
