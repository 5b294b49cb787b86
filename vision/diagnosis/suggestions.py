"""What an image with few detections most likely needs: to be flipped, another print, or another dictionary.

A print is how markers of a dictionary are drawn: their border, and whether they are black on white.
"""

from collections.abc import Iterable
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
"""Detector with which all dictionaries are tried. Chosen: an image takes it the least time. Prints are tried
with the default one, since OpenCV's reads borders of other widths too, and puts their corners elsewhere."""

QUICK_BORDERS = (1, 2)
"""Borders, cells, with which the quick detector reads all prints. Measured: with 2 it reads 3 as well."""

SURE = 3
"""Number of markers beyond which no further print is searched. Chosen: fewer may decode by chance."""


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

    Tried are the image's mirror image, other prints of the same markers, and other dictionaries in all
    prints. The result names all options at once with which the default detector finds most markers.

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
    counts = _counts(image, dictionary, _prints(looked_for))
    best = max(counts, key=counts.__getitem__)  # the first of those that show as many
    most = max(counts[best], _ids(image, dictionary, looked_for, QUICK_DETECTOR).size)
    kinds = [best] if counts[best] >= SURE else _quick_prints(looked_for)
    other = _other_dictionary(image, kinds, most + 1)
    if other is not None:
        name, kind = other
        of_color = [kind, *(p for p in _prints(looked_for) if p.inverted == kind.inverted and p != kind)]
        others = _counts(image, name, of_color)
        there = max(others, key=others.__getitem__)
        if others[there] > most:
            return _in_words(looked_for, there, name)
    return None if best == looked_for else _in_words(looked_for, best)


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
    for detector, names in (
        (QUICK_DETECTOR, _decodable(check_grey(image), kind, 1)),
        (DEFAULT_DETECTOR, _largest_of_series()),
    ):
        best = _best_dictionary(image, detector, kind, names, 1)
        if best is not None:
            return best[0]
    return None


def _counts(image: Image, dictionary: str, prints: list[MarkerPrint]) -> dict[MarkerPrint, int]:
    """Return the number of markers of a dictionary that the default detector finds in each print."""
    return {kind: _ids(image, dictionary, kind, DEFAULT_DETECTOR).size for kind in prints}


def _prints(looked_for: MarkerPrint) -> list[MarkerPrint]:
    """Return all prints: the one that was searched for, others of its colour, then those of the other."""
    prints = [
        MarkerPrint(border_bits, inverted)
        for inverted in (looked_for.inverted, not looked_for.inverted)
        for border_bits in range(1, MAX_BORDER_BITS + 1)
    ]
    return [looked_for, *(kind for kind in prints if kind != looked_for)]


def _quick_prints(looked_for: MarkerPrint) -> list[MarkerPrint]:
    """Return the prints in which to search for dictionaries, those nearest to the given one first."""
    borders = sorted(QUICK_BORDERS, key=lambda border_bits: abs(border_bits - looked_for.border_bits))
    colors = looked_for.inverted, not looked_for.inverted
    return [MarkerPrint(border_bits, inverted) for border_bits in borders for inverted in colors]


def _other_dictionary(
    image: Image, kinds: list[MarkerPrint], at_least: int
) -> tuple[str, MarkerPrint] | None:
    """Return the dictionary and print of which the quick detector finds most, or None below `at_least`.

    The search ends at the first print with `SURE` markers.
    """
    other = None
    for kind in kinds:
        best = _best_dictionary(image, QUICK_DETECTOR, kind, _decodable(image, kind, at_least), at_least)
        if best is not None:
            name, count = best
            other, at_least = (name, kind), max(at_least, count + 1)
            if count >= SURE:
                break
    return other


def _decodable(image: Image, kind: MarkerPrint, at_least: int) -> list[str]:
    """Return the dictionaries of which OpenCV's detector may read `at_least` markers in a print.

    All codes of one size are read together. A marker that one of their dictionaries decodes is then decoded.
    This takes 4 detections of an image where the dictionaries take 14.
    """
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = kind.border_bits
    names: list[str] = []
    for codes, members in _codes_by_size():
        found = cv2.aruco.ArucoDetector(codes, parameters).detectMarkers(_dark_on_light(image, kind))[0]
        names += members if len(found) >= at_least else []
    return names


@cache
def _codes_by_size() -> tuple[tuple[cv2.aruco.Dictionary, tuple[str, ...]], ...]:
    """Return, for each size of code, one dictionary of all codes and the names of its members."""
    members: dict[int, list[str]] = {}
    for name in _largest_of_series():
        members.setdefault(int(load_dictionary(name).markerSize), []).append(name)
    return tuple(
        (
            cv2.aruco.Dictionary(
                np.concatenate([load_dictionary(name).bytesList for name in names]),
                cells,
                max(int(load_dictionary(name).maxCorrectionBits) for name in names),
            ),
            tuple(names),
        )
        for cells, names in members.items()
    )


def _in_words(looked_for: MarkerPrint, there: MarkerPrint, dictionary: str | None = None) -> str:
    """Return the differences of the markers in an image from those looked for, with all options for them."""
    facts, options = [], []
    if there.border_bits != looked_for.border_bits:
        facts.append(f"drawn with a border of {there.border_bits} cell(s)")
        options.append(f"--border-bits {there.border_bits}")
    if dictionary is not None:
        facts.append("of another dictionary")
        options.append(f"--dictionary {dictionary}")
    if there.inverted > looked_for.inverted:
        facts.insert(0, "white on black")
        options.insert(0, "--inverted")
    elif there.inverted < looked_for.inverted:
        facts.insert(0, "black on white")
        options.append("without --inverted")
    return f"its markers are {_listed(facts)}; try {' '.join(options)}"


def _listed(facts: list[str]) -> str:
    """Return a list as English writes it: `a`, `a and b` or `a, b and c`."""
    return " and ".join(part for part in (", ".join(facts[:-1]), facts[-1]) if part)


def _ids(image: Image, dictionary: str, kind: MarkerPrint, detector: str) -> IntArray:
    """Ids (N,) of the markers of a dictionary in that print that a detector finds in an image."""
    return create_detector(detector, dictionary=dictionary, **kind._asdict()).detect(image).ids


def _dark_on_light(image: Image, kind: MarkerPrint) -> Image:
    """Return the image in which markers of a print are black on white: the negative if they are inverted."""
    return np.asarray(cv2.bitwise_not(image), dtype=np.uint8) if kind.inverted else image


def _best_dictionary(
    image: Image, detector: str, kind: MarkerPrint, names: Iterable[str], at_least: int
) -> tuple[str, int] | None:
    """Return the dictionary of which a detector finds most markers in a print, and their number.

    Args:
        image: grey, (height, width).
        detector: name of the detector.
        kind: the print.
        names: dictionaries to try, the largest of each series.
        at_least: number of markers below which the result is None.
    """
    best = None
    for name in names:
        ids = _ids(image, name, kind, detector)
        rank = ids.size, int(load_dictionary(name).maxCorrectionBits), -dictionary_size(name)
        if ids.size >= at_least and (best is None or rank > best[0]):
            best = rank, name, int(ids.max())
    return None if best is None else (_smallest_with(best[1], best[2]), best[0][0])


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
