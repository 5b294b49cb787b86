"""Why a candidate is no detection: the limits, which of them it breaks, and how that is put into words."""

from enum import Enum

import numpy as np

from skyherd.geometry import Array
from skyherd.markers.dictionary import cells_per_side
from skyherd.vision.diagnosis.quad_reading import Reading

ENOUGH_CELL_PX = 3.0
"""Pixels a cell from which on hardly a marker is missed. Measured: 18 px for the 6 cells of 4x4
(`detectors/photometric_accuracy.toml`: all are found)."""

ENOUGH_CONTRAST = 40.0
"""Smallest difference of white and black, grey levels, that is called enough. Chosen: ten times the usual
noise and more."""

MAX_BLUR_CELLS = 0.55
"""Standard deviation of the blur, in cells, beyond which neighbouring cells run into each other. Chosen: half
a cell and a little."""

OBLIQUE_DEG = 60.0
"""Tilt, degrees, beyond which a marker with too few pixels is called oblique instead. Derived: its cells are
then half as high as wide, `cos 60°`."""

QUIET_SHARE = 0.4
"""A quiet zone must lie at least this share of the way from black to white on every side. Chosen: a little
less than half, since blur darkens a narrow zone."""

BORDER_PX = 1.5
"""A marker with a corner nearer to the image's border than this, px, is cut. Chosen: contours are found to
about a pixel."""

MARKER_LIKE = 0.6
"""Likeness of a clear frame below which its content is not taken as bits. Chosen: below a marker with several
wrong cells, above most other drawings."""

KNOWN_SHARE = 0.75
"""Share of a cut marker that must be in the image to say which marker it is. Chosen: less is like several."""

CERTAIN = 0.9
"""Likeness of what is plainly a marker. Small or faint candidates have to reach it, since chance is like some
marker too. Chosen between such likenesses and those of undamaged markers, 0.95 and more."""

MIN_CONTRAST = 8.0
"""Difference of white and black, grey levels, that bits must exceed. Chosen: above the usual noise of 3."""

BIT_SHARE = 0.3
"""Share of the step from the border to the surroundings that the contrast of bits must exceed. Chosen: a
white cell is as bright as the card but for blur."""

DARK_LEVELS = 25.0
"""A dark quadrilateral without bits is reported if its surroundings are brighter by this, grey levels.
Chosen: fainter ones are shadows and texture."""

MIN_QUIET_CONTRAST = 1.0
"""Smallest contrast, grey levels, that the quiet zone's level is compared with, so that none divides by
zero."""


class Reason(Enum):
    """Why a candidate is no detection; the values are the words that users read.

    Of several reasons that hold, the first in this order is given.
    """

    NO_BITS = "no bits"
    CUT = "cut by the border"
    LOW_CONTRAST = "low contrast"
    MIRRORED = "mirrored"
    REPEATED = "id seen twice"
    OBLIQUE = "too oblique"
    FEW_PIXELS = "too few pixels a cell"
    BLURRED = "too blurred"
    NO_QUIET_ZONE = "no quiet zone"
    WRONG_BITS = "bits wrong"
    OVERLOOKED = "overlooked"


def find_reason(reading: Reading, image_size_px: Array, *, again: bool) -> Reason:
    """Return the first reason that holds, in the order of `Reason`; `OVERLOOKED` if none does.

    Args:
        reading: of the candidate.
        image_size_px: (2,) width and height of the image.
        again: whether its id was read without a fault elsewhere too.
    """
    exact = reading.wrong_bits == 0 and reading.likeness >= CERTAIN
    short = reading.cell_px[0]
    tests = (
        (Reason.NO_BITS, not _has_bits(reading)),
        (Reason.CUT, is_cut(reading, image_size_px)),
        (Reason.LOW_CONTRAST, reading.contrast < ENOUGH_CONTRAST),
        (Reason.MIRRORED, exact and reading.mirrored),
        (Reason.REPEATED, exact and again),
        (Reason.OBLIQUE, reading.tilt_deg > OBLIQUE_DEG and short < ENOUGH_CELL_PX),
        (Reason.FEW_PIXELS, short < ENOUGH_CELL_PX),
        (Reason.BLURRED, reading.blur_cells > MAX_BLUR_CELLS),
        (Reason.NO_QUIET_ZONE, bool(_lacks_quiet(reading).any())),
        (Reason.WRONG_BITS, reading.wrong_bits > 0),
    )
    return next((reason for reason, holds in tests if holds), Reason.OVERLOOKED)


def _has_bits(reading: Reading) -> bool:
    """Whether it is plainly a marker, or a large, sharp and clear frame with something in it."""
    if reading.contrast <= max(MIN_CONTRAST, BIT_SHARE * reading.depth):
        return False
    clear = reading.framed and reading.cell_px[0] >= ENOUGH_CELL_PX and reading.contrast >= ENOUGH_CONTRAST
    clear = clear and reading.blur_cells <= MAX_BLUR_CELLS and not _lacks_quiet(reading).any()
    return reading.likeness >= (MARKER_LIKE if clear else CERTAIN)


def is_dark(reading: Reading) -> bool:
    """Return whether a candidate is clearly darker than its surroundings, with bits in it or without."""
    return reading.depth >= DARK_LEVELS


def is_cut(reading: Reading, image_size_px: Array) -> bool:
    """Return whether a candidate reaches the border of an image of size (2,), width and height."""
    corners = reading.corners_px
    return bool(((corners < BORDER_PX) | (corners > image_size_px - 1 - BORDER_PX)).any())


def _lacks_quiet(reading: Reading) -> Array:
    """(4,) whether the quiet zone beside each edge is too dark."""
    share = (reading.quiet - reading.black) / max(reading.contrast, MIN_QUIET_CONTRAST)
    return np.asarray(share < QUIET_SHARE)


WORDS = {
    Reason.NO_BITS: "a dark quadrilateral without bits",
    Reason.CUT: "{seen} in the picture{known}: all of it must be, with its white margin",
    Reason.LOW_CONTRAST: "white {white:.0f} is only {contrast:.0f} grey levels above black {black:.0f}, "
    "at least {enough_contrast:.0f} are needed ({like}): more light, less glare, a better print",
    Reason.MIRRORED: "the mirror image of id {id}: flip the picture left to right",
    Reason.REPEATED: "id {id} is there more than once, so that none is trusted: use each id once",
    Reason.OBLIQUE: "seen {tilt_deg:.0f} deg from straight above, {cell_px:.1f} px a cell the short way, "
    "at least {enough_cell_px:.0f} are needed ({like}): look from above, or fly nearer",
    Reason.FEW_PIXELS: "{cell_px:.1f} px a cell, at least {enough_cell_px:.0f} are needed ({like}): "
    "fly lower, zoom in or print larger",
    Reason.BLURRED: "blurred by {blur_px:.1f} px, {blur_cells:.1f} of a cell; at most {most_blur_cells:g} "
    "can be read ({like}): focus, expose for less time, or print larger",
    Reason.NO_QUIET_ZONE: "no white margin at {dark_edges} of its 4 edges ({like}): leave one cell, "
    "{cell_percent:.0f} % of its side, white all around",
    Reason.WRONG_BITS: "{wrong} of {cells} cells differ from the nearest marker, id {id}: covered "
    "in part, dirty, or of another dictionary than {dictionary}",
    Reason.OVERLOOKED: "reads as id {id} without a fault, {cell_px:.1f} px a cell: try another detector",
}
"""What users read for each reason, with places for the numbers that `describe` fills in."""


def describe(reason: Reason, reading: Reading, dictionary: str) -> str:
    """Return the reason with the numbers that were measured, and what to do about it, in words."""
    r, n = reading, cells_per_side(dictionary)
    like = f"most like id {r.nearest_id}"
    if r.wrong_bits:
        like += f", {r.wrong_bits} of {n * n} cells wrong"
    return WORDS[reason].format(
        like=like,
        known=f" ({like})" if r.visible > KNOWN_SHARE else "",
        seen=f"only {r.visible:.0%} of it is" if r.visible < 1 else "it touches the edge of what is",
        id=r.nearest_id,
        wrong=r.wrong_bits,
        cells=n * n,
        cell_percent=100 / n,
        cell_px=r.cell_px[0],
        enough_cell_px=ENOUGH_CELL_PX,
        black=r.black,
        white=r.white,
        contrast=r.contrast,
        enough_contrast=ENOUGH_CONTRAST,
        blur_px=r.blur_cells * r.cell_px.mean(),
        blur_cells=r.blur_cells,
        most_blur_cells=MAX_BLUR_CELLS,
        tilt_deg=r.tilt_deg,
        dark_edges=int(_lacks_quiet(r).sum()),
        dictionary=dictionary,
    )
