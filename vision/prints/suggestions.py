"""Advice for an image with few detections: to flip it, to use another print or dictionary, or `repeats=True`.

The evidence of the image's dark and light squares ranks all prints of all dictionaries (`print_evidence`).
The default detector confirms the best of them.
"""

import math
from typing import NamedTuple

import numpy as np

from skyherd.markers.dictionary import canonical_name, load_dictionary, with_border
from skyherd.vision.detectors.registry import (
    DEFAULT_DETECTOR,
    DEFAULT_DICTIONARY,
    create_detector,
    describe_mirrored,
)
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.photometric.detector import PhotometricDetector
from skyherd.vision.prints.print_evidence import (
    ALL_PRINTS,
    MarkerPrint,
    PrintEvidence,
    PrintSearch,
    larger_of_series,
)

MIN_LOG_EVIDENCE = 0.0
"""Smallest evidence of a print that the detector is asked to confirm. Derived: from there on markers are more
probable than chance. A single marker of 16 bits among ten other dark squares has 1 to 2."""

LOG_ODDS_OF_DIFFERENCE = -math.log(10)
"""Prior log odds of each way in which a print differs from the one looked for: by its border, its colours, or
as a mirror image. Chosen: most users name the print of their markers rightly."""

MAX_CONFIRMED = 3
"""Number of prints that the detector is asked to confirm. Chosen: each takes up to 0.4 s on 9 megapixels."""


class MarkerCount(NamedTuple):
    """Numbers of markers of one print in an image.

    Attributes:
        markers: all of them.
        repeated: those whose id another marker has, too.
    """

    markers: int
    repeated: int


def suggest(
    image: Image,
    dictionary: str,
    *,
    border_bits: int = 1,
    inverted: bool = False,
    repeats: bool = False,
    detector: str = DEFAULT_DETECTOR,
) -> str | None:
    """Return what to try where little was found in a grey image, in words; None if nothing helps.

    Considered are the image's mirror image, other prints of the same markers, other dictionaries in all
    prints, and ids that repeat. The result names all options at once with which the default detector finds
    more markers.

    Args:
        image: grey, (height, width), as it was taken.
        dictionary: of the markers that were looked for, without a border after its name.
        border_bits: width of the border that was looked for, in cells.
        inverted: whether white markers on black were looked for.
        repeats: whether ids that repeat were reported.
        detector: name of the detector that was used.

    Raises:
        InputError: the image is not a grey one of 8 bits, or there is no such dictionary or border.
    """
    image, dictionary = check_grey(image), canonical_name(dictionary)
    load_dictionary(with_border(dictionary, border_bits))
    looked_for = PrintEvidence(dictionary, MarkerPrint(border_bits, inverted), -np.inf)
    search = PrintSearch(image, ALL_PRINTS)
    ranked = search.ranked()
    own = next((one for one in ranked if one[:2] == looked_for[:2]), looked_for)
    likely = _likely(ranked, looked_for.kind)
    others = [one for one in likely if one != own and one.log_evidence >= own.log_evidence]
    if not others and (repeats or own.log_evidence < MIN_LOG_EVIDENCE):
        return None
    found = None
    for best in others:
        there = _confirm(search, best)
        if not there.markers:
            continue
        found = found or _count(image, looked_for)
        is_mirrored = best[:2] == (dictionary, looked_for.kind._replace(mirrored=True))
        if is_mirrored or there.markers <= found.markers:
            there = _count(image, best)
        if there.markers > found.markers:
            option = "" if repeats or not there.repeated else _repeats_option(detector)
            if is_mirrored:
                advice = describe_mirrored(found.markers, there.markers)
                return f"{advice}; its ids repeat: add {option}" if option else advice
            return _in_words(looked_for, best, option)
    if repeats or own.log_evidence < MIN_LOG_EVIDENCE:
        return None
    found = found or _count(image, looked_for)
    if not found.repeated:
        return None
    left_out = f"{found.repeated} markers of {dictionary} share their ids and are left out"
    return f"{left_out}; try {_repeats_option(detector)}"


def find_dictionary(image: Image, *, border_bits: int = 1, inverted: bool = False) -> str | None:
    """Return the dictionary of the markers in a grey image (height, width); None if no marker is found.

    All dictionaries are compared by the evidence in the image. Of a series such as 4X4_50 to 4X4_1000 it is
    the smallest that has all ids found.

    Args:
        image: grey, (height, width).
        border_bits: width of the markers' border, in cells.
        inverted: whether the markers are white on black.

    Raises:
        InputError: the image is not a grey one of 8 bits, or the border not one of 1 to 3 cells.
    """
    image = check_grey(image)
    with_border(DEFAULT_DICTIONARY, border_bits)
    kind = MarkerPrint(border_bits, inverted)
    ranked = _likely(PrintSearch(image, [kind]).ranked(), kind)
    for best in ranked:
        if markers := _count(image, best).markers:
            return _with_all_ids(image, best, markers)
    return None


def _with_all_ids(image: Image, there: PrintEvidence, markers: int) -> str:
    """Return the smallest dictionary of a series with which most markers are found.

    `there` is a print of that series with which a number of markers is found. The evidence takes all ids for
    equally probable. Real ids begin with 0, so that it prefers a dictionary which lacks the last few.
    """
    *between, largest = larger_of_series(there.dictionary) or (there.dictionary,)
    if largest == there.dictionary:
        return largest
    most = _count(image, there._replace(dictionary=largest)).markers
    if most <= markers:
        return there.dictionary
    counted = (name for name in between if _count(image, there._replace(dictionary=name)).markers >= most)
    return next(counted, largest)


def _likely(ranked: list[PrintEvidence], looked_for: MarkerPrint) -> list[PrintEvidence]:
    """Return the prints to confirm, by their posterior log odds in descending order."""

    def log_odds(there: PrintEvidence) -> float:
        differences = sum(own != other for own, other in zip(there.kind, looked_for, strict=True))
        return there.log_evidence + differences * LOG_ODDS_OF_DIFFERENCE

    likely = [one for one in ranked if one.log_evidence >= MIN_LOG_EVIDENCE]
    return sorted(likely, key=log_odds, reverse=True)[:MAX_CONFIRMED]


def _confirm(search: PrintSearch, there: PrintEvidence) -> MarkerCount:
    """Return the numbers of markers of a print among the squares that gave the evidence for it.

    A search of the whole image, as `_count` has, takes several times as long, and finds some fainter ones.
    """
    name = with_border(there.dictionary, there.kind.border_bits)
    found = PhotometricDetector(name, following=False, repeats=True).measured(*search.likely_squares(there))
    return MarkerCount(len(found), int(found.repeated.sum()))


def _count(image: Image, there: PrintEvidence) -> MarkerCount:
    """Return the numbers of markers of a print that the default detector finds."""
    image = np.ascontiguousarray(image[:, ::-1]) if there.kind.mirrored else image
    detector = create_detector(
        dictionary=there.dictionary,
        border_bits=there.kind.border_bits,
        inverted=there.kind.inverted,
        repeats=True,
    )
    found = detector.detect(image)
    return MarkerCount(len(found), int(found.repeated.sum()))


def _repeats_option(detector: str) -> str:
    """Return the keywords that report ids that repeat, which only the default detector does."""
    repeats = "`repeats=True`"
    return repeats if detector == DEFAULT_DETECTOR else f"`detector={DEFAULT_DETECTOR}` {repeats}"


def _in_words(looked_for: PrintEvidence, there: PrintEvidence, repeats_option: str) -> str:
    """Return the differences of the markers in an image from those looked for, with all options for them.

    `repeats_option` is that for ids that repeat, or empty.
    """
    facts, options = [], []
    if there.kind.border_bits != looked_for.kind.border_bits:
        facts.append(f"drawn with a border of {there.kind.border_bits} cell(s)")
        options.append(f"`border_bits={there.kind.border_bits}`")
    if there.dictionary != looked_for.dictionary:
        facts.append("of another dictionary")
        options.append(f"`dictionary={there.dictionary}`")
    if there.kind.inverted > looked_for.kind.inverted:
        facts.insert(0, "white on black")
        options.insert(0, "`inverted=True`")
    elif there.kind.inverted < looked_for.kind.inverted:
        facts.insert(0, "black on white")
        options.append("`inverted=False`")
    if there.kind.mirrored:
        facts.insert(0, "mirrored")
    are = f"its markers are {_listed(facts)}"
    if repeats_option:
        are += ", and their ids repeat"
        options.insert(-1 if options[-1:] == ["`inverted=False`"] else len(options), repeats_option)
    flip = "flip it left to right and " * there.kind.mirrored
    return f"{are}; {flip}try {' '.join(options)}"


def _listed(facts: list[str]) -> str:
    """Return a list as English writes it: `a`, `a and b` or `a, b and c`."""
    return " and ".join(part for part in (", ".join(facts[:-1]), facts[-1]) if part)
