"""What users read of each reason, and what they can do about it."""

from skyherd.markers.dictionary import cells_per_side
from skyherd.vision.diagnosis.reading import Reading
from skyherd.vision.diagnosis.reasons import Measured, Reason, edges_without_quiet

SHOWN_CELLS = 4
"""Most wrong cells that are named one by one. Chosen: they fit into a line."""

WORDS = {
    Reason.REPEATED: "id {id} is there more than once, so that none is trusted: use each id once, or report "
    "all of them with --repeats",
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
    Reason.WRONG_CELL: "{measured} ({like}): covered or shaded in part, dirty, or too much sharpening and "
    "compression",
    Reason.UNLIKE_PIXELS: "{measured} ({like}): bent, covered in part, glare, or too much sharpening and "
    "compression",
    Reason.UNLIKE_CELLS: "{measured} ({like}): glare or shade across it, or covered in part",
    Reason.PALE_PRINT: "{measured} ({like}): print all markers alike, without glare",
}
"""What users read for each reason, with places for the numbers that `describe` fills in."""


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
        dark_edges=int(edges_without_quiet(reading).sum()),
        dictionary=dictionary,
    )
