"""What an image with few detections most likely needs: to be flipped, another print, or another dictionary.

A print is how markers of a dictionary are drawn: their border, and whether they are black on white.
"""

from functools import cache
from typing import NamedTuple

import cv2
import numpy as np

from skyherd.geometry import IntArray
from skyherd.markers.dictionary import (
    MAX_BORDER_BITS,
    dictionary_names,
    dictionary_size,
    load_dictionary,
    marker_cells,
    with_border,
)
from skyherd.vision.detectors.registry import DEFAULT_DETECTOR, create_detector, explain_mirrored
from skyherd.vision.grey import Image, check_grey

QUICK_DETECTOR = "opencv"
"""Detector with which all dictionaries are tried, one after the other. Chosen: an image takes it the least
time. Prints are tried with the default one, since OpenCV's reads borders of other widths too, and puts their
corners elsewhere."""


class MarkerPrint(NamedTuple):
    """Print of markers: their colours and border.

    Attributes:
        border_bits: width of their black border, in cells.
        inverted: whether they are white on black.
    """

    border_bits: int = 1
    inverted: bool = False


def suggest(image: Image, dictionary: str, *, border_bits: int = 1, inverted: bool = False) -> str | None:
    """Return what to try where little was found in a grey image, in words; None if nothing helps.

    Tried are, in this order: the image's mirror image, other prints of the same markers, other dictionaries
    in the same print and, if nothing at all is found, in the other colour.

    Args:
        image: grey, (height, width), as it was taken.
        dictionary: of the markers that were looked for, without a border after its name.
        border_bits: width of the border that was looked for, in cells.
        inverted: whether white markers on black were looked for.

    Raises:
        InputError: the image is not a grey one of 8 bits, or there is no such dictionary or border.
    """
    looked_for, image = MarkerPrint(border_bits, inverted), check_grey(image)
    named = with_border(dictionary, border_bits)
    mirrored = explain_mirrored(_dark_on_light(image, looked_for), named)
    if mirrored is not None:
        return mirrored
    counts = {kind: _ids(image, dictionary, kind, DEFAULT_DETECTOR).size for kind in _prints(looked_for)}
    best = max(counts, key=counts.__getitem__)  # the first of those that show as many
    if best != looked_for:
        return _in_words(looked_for, best)
    found = _ids(image, dictionary, looked_for, QUICK_DETECTOR).size
    other = _best_dictionary(image, QUICK_DETECTOR, looked_for, found + 1)
    if other is not None or counts[looked_for]:
        return None if other is None else _in_words(looked_for, looked_for, other)
    negative = looked_for._replace(inverted=not inverted)
    other = _best_dictionary(image, QUICK_DETECTOR, negative, 1)
    return None if other is None else _in_words(looked_for, negative, other)


def find_dictionary(image: Image, *, border_bits: int = 1, inverted: bool = False) -> str | None:
    """Return the dictionary that decodes most of a grey image (height, width); None if none decodes anything.

    All dictionaries are tried. Of those that decode as many markers, the one whose markers differ most from
    each other is preferred. Of a series such as 4X4_50 to 4X4_1000 it is the smallest that has all ids found.
    If OpenCV's detector reads nothing, the default one is asked, which takes seconds.

    Args:
        image: grey, (height, width).
        border_bits: width of the markers' border, in cells.
        inverted: whether the markers are white on black.

    Raises:
        InputError: the image is not a grey one of 8 bits, or the border not one of 1 to 3 cells.
    """
    kind = MarkerPrint(border_bits, inverted)
    return _best_dictionary(image, QUICK_DETECTOR, kind, 1) or _best_dictionary(
        image, DEFAULT_DETECTOR, kind, 1
    )


def _prints(looked_for: MarkerPrint) -> list[MarkerPrint]:
    """Return all prints: the one that was searched for, others of its colour, then those of the other."""
    prints = [
        MarkerPrint(border_bits, inverted)
        for inverted in (looked_for.inverted, not looked_for.inverted)
        for border_bits in range(1, MAX_BORDER_BITS + 1)
    ]
    return [looked_for, *(kind for kind in prints if kind != looked_for)]


def _in_words(looked_for: MarkerPrint, there: MarkerPrint, dictionary: str | None = None) -> str:
    """Another kind of markers that an image shows, with the options for it."""
    facts, options = [], []
    if there.inverted != looked_for.inverted:
        facts.append("white on black" if there.inverted else "black on white")
        options.append("--inverted" if there.inverted else "without --inverted")
    if there.border_bits != looked_for.border_bits:
        facts.append(f"drawn with a border of {there.border_bits} cell(s)")
        options.append(f"--border-bits {there.border_bits}")
    if dictionary is not None:
        facts.append("of another dictionary")
        options.append(f"--dictionary {dictionary}")
    return f"its markers are {' and '.join(facts)}; try {' '.join(options)}"


def _ids(image: Image, dictionary: str, kind: MarkerPrint, detector: str) -> IntArray:
    """Ids (N,) of the markers of a dictionary in that print that a detector finds in an image."""
    return create_detector(detector, dictionary=dictionary, **kind._asdict()).detect(image).ids


def _dark_on_light(image: Image, kind: MarkerPrint) -> Image:
    """Return the image in which markers of a print are black on white: the negative if they are inverted."""
    return np.asarray(cv2.bitwise_not(image), dtype=np.uint8) if kind.inverted else image


def _best_dictionary(image: Image, detector: str, kind: MarkerPrint, at_least: int) -> str | None:
    """Return the dictionary of which a detector finds most markers in a print, or None below `at_least`."""
    best = None
    for name in _largest_of_series():
        ids = _ids(image, name, kind, detector)
        rank = ids.size, int(load_dictionary(name).maxCorrectionBits), -dictionary_size(name)
        if ids.size >= at_least and (best is None or rank > best[0]):
            best = rank, name, int(ids.max())
    return None if best is None else _smallest_with(best[1], best[2])


def _series(name: str) -> list[str]:
    """Dictionaries that begin with the same markers, `name` among them, smallest first."""
    cells = load_dictionary(name).markerSize
    same = [other for other in _distinct_names() if load_dictionary(other).markerSize == cells]
    first = marker_cells(name, 0)
    return sorted((n for n in same if np.array_equal(marker_cells(n, 0), first)), key=dictionary_size)


def _distinct_names() -> list[str]:
    """Names without those that differ from another in capitals alone."""
    return list({name.lower(): name for name in dictionary_names()}.values())


@cache
def _largest_of_series() -> tuple[str, ...]:
    return tuple(sorted({_series(name)[-1] for name in _distinct_names()}))


def _smallest_with(name: str, marker_id: int) -> str:
    """Return the smallest dictionary of the series of `name` that has a marker of that id."""
    return next(other for other in _series(name) if dictionary_size(other) > marker_id)
