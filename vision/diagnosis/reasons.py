"""Why a candidate that was read is no detection: the limits, which of them it breaks, and how to say so."""

from enum import Enum

import numpy as np

from skyherd.geometry import Array
from skyherd.markers.dictionary import cells_per_side
from skyherd.vision.diagnosis.quad_reading import Reading

ENOUGH_CELL_PX = 3.0
"""Pixels a cell from which on hardly a marker is missed: 18 px for those of 4x4."""

ENOUGH_CONTRAST = 40.0
"""Grey levels between black and white, at least."""

BLUR_CELLS = 0.55
"""Standard deviation of the blur, in cells, beyond which neighbouring cells run into each other."""

OBLIQUE_DEG = 60.0
"""A marker with too few pixels only because it is seen at more than this is called oblique."""

QUIET_SHARE = 0.4
"""A quiet zone must lie at least this share of the way from black to white on every side."""

BORDER_PX = 1.5
"""A marker with a corner nearer to the image's border than this is cut."""

MARKER_LIKE = 0.6
"""Likeness of a frame below which what is in it is taken to be no bits."""

KNOWN_SHARE = 0.75
"""Of a cut marker so much must be seen to say which it is."""

CERTAIN = 0.9
"""Likeness of what is plainly a marker; small or faint ones have to reach it, chance being like them too."""

MIN_CONTRAST = 8.0
BIT_SHARE = 0.3
"""Bright cells lie above black by more than these: grey levels, and share of what is around the marker."""

DARK_LEVELS = 25.0
"""A dark quadrilateral without bits is worth a word if what is around it is brighter by this."""


class Reason(Enum):
    """Why a candidate is no detection."""

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
    """The first reason that holds, in the order of `Reason`.

    Args:
        reading: of the candidate.
        image_size_px: (2,) width and height.
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
        (Reason.BLURRED, reading.blur_cells > BLUR_CELLS),
        (Reason.NO_QUIET_ZONE, bool(_lacks_quiet(reading).any())),
        (Reason.WRONG_BITS, reading.wrong_bits > 0),
    )
    return next((reason for reason, holds in tests if holds), Reason.OVERLOOKED)


def _has_bits(reading: Reading) -> bool:
    """Whether it is plainly a marker, or a large, sharp and clear frame with something in it."""
    if reading.contrast <= max(MIN_CONTRAST, BIT_SHARE * reading.depth):
        return False
    clear = reading.framed and reading.cell_px[0] >= ENOUGH_CELL_PX and reading.contrast >= ENOUGH_CONTRAST
    clear = clear and reading.blur_cells <= BLUR_CELLS and not _lacks_quiet(reading).any()
    return reading.likeness >= (MARKER_LIKE if clear else CERTAIN)


def is_dark(reading: Reading) -> bool:
    """Whether it stands out from what is around it, with bits in it or without."""
    return reading.depth >= DARK_LEVELS


def is_cut(reading: Reading, image_size_px: Array) -> bool:
    """Whether it reaches the border of the image."""
    corners = reading.corners_px
    return bool(((corners < BORDER_PX) | (corners > image_size_px - 1 - BORDER_PX)).any())


def _lacks_quiet(reading: Reading) -> Array:
    """(4,) whether the quiet zone beside each edge is too dark."""
    share = (reading.quiet - reading.black) / max(reading.contrast, 1.0)
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
"""What is said of each reason, and what to do about it."""


def describe(reason: Reason, reading: Reading, dictionary: str) -> str:
    """The reason with its numbers, and what to do about it."""
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
        most_blur_cells=BLUR_CELLS,
        tilt_deg=r.tilt_deg,
        dark_edges=int(_lacks_quiet(r).sum()),
        dictionary=dictionary,
    )
