"""Views of a survey: the markers in each picture, with the calibration of its camera."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skyherd.errors import InputError
from skyherd.files.images import read_grey
from skyherd.inspection import output_name
from skyherd.jobs.progress import NO_PROGRESS, Progress
from skyherd.poses import Calibration, View, read_calibration
from skyherd.vision import create_detector, measure_outlines


def take_views(
    pictures: Sequence[Path],
    cameras: Sequence[str],
    *,
    dictionary: str,
    detector: str = "photometric",
    border_bits: int = 1,
    inverted: bool = False,
    progress: Progress = NO_PROGRESS,
) -> list[View]:
    """Detect the markers of pictures; return a view for each, under a unique name.

    An id that a picture shows twice is left out.

    Args:
        pictures: the files.
        cameras: calibration files as `FILE` or `FILE#NAME`: one of all pictures, or one of each.
        dictionary: name of the markers' dictionary.
        detector: name of the detector, or `module:factory`.
        border_bits: width of the markers' black border in cells.
        inverted: True for white markers on black.
        progress: receives the number of pictures that are done.

    Raises:
        InputError: a picture or calibration cannot be read, their numbers or sizes differ, or a picture shows
            no marker.
    """
    calibrations = _calibrations(cameras, len(pictures))
    names = _names(pictures)
    views = []
    for done, (picture, calibration, name) in enumerate(zip(pictures, calibrations, names, strict=True)):
        progress.update("pictures", done, len(pictures))
        image = read_grey(picture)
        calibration.check_image(str(picture), (image.shape[1], image.shape[0]))
        found = create_detector(
            detector, dictionary=dictionary, border_bits=border_bits, inverted=inverted
        ).detect(image)
        found = found.unambiguous()
        if not len(found):
            raise InputError(
                str(picture),
                f"shows no marker of {dictionary}",
                f"leave it out; `skyherd detect {picture} --explain` says why",
            )
        found = found[np.argsort(found.ids)]
        outlines = measure_outlines(image, found, dictionary, border_bits=border_bits, inverted=inverted)
        views.append(View(name, calibration, found.ids, *outlines))
    progress.update("pictures", len(pictures), len(pictures))
    return views


def _calibrations(cameras: Sequence[str], count: int) -> list[Calibration]:
    if len(cameras) not in (1, count):
        raise InputError(
            "--camera",
            f"{len(cameras)} calibrations for {count} pictures",
            "one for all pictures, or one for each, in their order",
        )
    found = [read_calibration(camera) for camera in cameras]
    return found * count if len(found) == 1 else found


def _names(pictures: Sequence[Path]) -> list[str]:
    """Return a short unique name of each picture: its stem, or its path if two stems are equal."""
    stems = [output_name(picture.stem) for picture in pictures]
    names = stems if len(set(stems)) == len(stems) else [str(picture) for picture in pictures]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(twice, "is given twice", "each picture once")
    return names
