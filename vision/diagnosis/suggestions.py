"""What an image with few detections most likely needs: another dictionary, or to be flipped."""

from functools import cache

import numpy as np

from skyherd.markers.dictionary import dictionary_names, dictionary_size, load_dictionary, marker_cells
from skyherd.vision.detectors.registry import DEFAULT_DETECTOR, create_detector, explain_mirrored
from skyherd.vision.grey import Image

QUICK_DETECTOR = "opencv"
"""Detector with which all dictionaries are tried, one after the other. Chosen: an image takes it the least
time."""


def suggest_dictionary(image: Image, dictionary: str) -> str | None:
    """Return the dictionary that decodes more of a grey image than `dictionary` does; None if there is none.

    Of dictionaries that decode as many markers, the one whose markers differ most from each other is
    preferred, and of a series such as 4X4_50 to 4X4_1000 the smallest that has all ids found. All
    dictionaries are tried.
    """
    found = create_detector(QUICK_DETECTOR, dictionary=dictionary).detect(image)
    return _best_dictionary(image, QUICK_DETECTOR, len(found) + 1)


def find_dictionary(image: Image) -> str | None:
    """Return the dictionary that decodes most of a grey image (height, width); None if none decodes anything.

    The preferences are those of `suggest_dictionary`. If OpenCV's detector reads nothing, the default one
    is asked, which takes seconds.

    Raises:
        InputError: the image is not a grey one of 8 bits.
    """
    return _best_dictionary(image, QUICK_DETECTOR, 1) or _best_dictionary(image, DEFAULT_DETECTOR, 1)


def _best_dictionary(image: Image, detector: str, at_least: int) -> str | None:
    """The dictionary of which a detector finds most markers, if it finds `at_least` so many."""
    best = None
    for name in _largest_of_series():
        ids = create_detector(detector, dictionary=name).detect(image).ids
        rank = ids.size, int(load_dictionary(name).maxCorrectionBits), -dictionary_size(name)
        if ids.size >= at_least and (best is None or rank > best[0]):
            best = rank, name, int(ids.max())
    return None if best is None else _smallest_with(best[1], best[2])


def suggest(image: Image, dictionary: str) -> str | None:
    """Return what to try where little was found in a grey image, in words; None if nothing helps.

    Raises:
        InputError: the image is not a grey one of 8 bits, or there is no such dictionary.
    """
    mirrored = explain_mirrored(image, dictionary)
    if mirrored is not None:
        return mirrored
    other = suggest_dictionary(image, dictionary)
    return None if other is None else f"its markers are of another dictionary; try --dictionary {other}"


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
    """The smallest dictionary of the series of `name` that has a marker of that id."""
    return next(other for other in _series(name) if dictionary_size(other) > marker_id)
