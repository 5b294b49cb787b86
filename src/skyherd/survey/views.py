"""Views of a survey: the markers in each picture, with the calibration of its camera."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.files.image_streams import is_stream, open_stream, read_stream
from skyherd.files.images import read_grey
from skyherd.files.rosbag_reader import is_bag
from skyherd.inspection import output_name
from skyherd.jobs.progress import NO_PROGRESS, Progress
from skyherd.poses import Calibration, View, read_calibration
from skyherd.vision import create_detector, measure_outlines

FRAMES = 20
"""Default number of images that are taken from a recording. Chosen: views of a robot every 18 degrees of a
turn."""


def take_views(
    pictures: Sequence[Path],
    calibrations: Sequence[str],
    *,
    dictionary: str,
    detector: str = "photometric",
    border_bits: int = 1,
    inverted: bool = False,
    frames: int = FRAMES,
    topic: str | None = None,
    fixed: Sequence[int] | None = None,
    progress: Progress = NO_PROGRESS,
) -> list[View]:
    """Detect the markers of pictures and recordings; return a view for each image, under a unique name.

    An id that an image shows twice is left out. An image of a recording that shows no marker of the frame is
    left out.

    Args:
        pictures: pictures, videos and rosbag2 recordings.
        calibrations: calibration files as `FILE` or `FILE#NAME`: one of all pictures, or one of each.
        dictionary: name of the markers' dictionary.
        detector: name of the detector, or `module:factory`.
        border_bits: width of the markers' black border in cells.
        inverted: True for white markers on black.
        frames: number of images that are taken from a recording, at equal distances.
        topic: topic of the images of rosbag2 recordings; None for their only one.
        fixed: markers of the frame; None if all are.
        progress: receives the number of pictures that are done.

    Raises:
        InputError: a picture, recording or calibration cannot be read, their numbers or sizes differ, one
            shows no marker, or a topic is given without a rosbag2 recording.
    """
    if topic is not None and not any(map(is_bag, pictures)):
        raise InputError("topic", "given without a rosbag2 recording", "leave it out")
    read = _calibrations(calibrations, len(pictures))
    names = _names(pictures)
    views: list[View] = []
    for done, (picture, calibration, name) in enumerate(zip(pictures, read, names, strict=True)):
        progress.update("pictures", done, len(pictures))
        before = len(views)
        for part, image in _images(picture, frames, topic if is_bag(picture) else None):
            calibration.check_image(str(picture), (image.shape[1], image.shape[0]))
            found = create_detector(
                detector, dictionary=dictionary, border_bits=border_bits, inverted=inverted
            ).detect(image)
            found = found.unambiguous()
            found = found[np.argsort(found.ids)]
            has_frame = len(found) and (fixed is None or np.isin(found.ids, fixed).any())
            if has_frame or (len(found) and not part):
                outlines = measure_outlines(
                    image, found, dictionary, border_bits=border_bits, inverted=inverted
                )
                views.append(View(f"{name}{part}", calibration, found.ids, *outlines))
        if len(views) == before:
            raise InputError(
                str(picture),
                f"shows no marker of {dictionary if fixed is None else '`fixed=`'}",
                f"leave it out; `skyherd detect {picture} --explain` says why",
            )
    progress.update("pictures", len(pictures), len(pictures))
    return views


def _images(path: Path, frames: int, topic: str | None) -> Iterator[tuple[str, npt.NDArray[np.uint8]]]:
    """Yield the images of a file, grey, each with the end of its name: its time in a recording."""
    if not is_stream(path):
        yield "", read_grey(path)
        return
    clip = open_stream(path, topic)
    count = clip.count or sum(1 for _ in read_stream(clip))
    wanted = set(np.linspace(0, count - 1, frames).round().astype(int).tolist())
    for frame in read_stream(clip):
        if frame.index in wanted:
            yield f" {frame.time_s:.2f} s", frame.image


def _calibrations(names: Sequence[str], count: int) -> list[Calibration]:
    if len(names) not in (1, count):
        raise InputError(
            "calibrations",
            f"{len(names)} calibrations for {count} files",
            "one for all, or one for each picture and recording, in their order",
        )
    found = [read_calibration(name) for name in names]
    return found * count if len(found) == 1 else found


def _names(pictures: Sequence[Path]) -> list[str]:
    """Return a short unique name of each picture: its stem, or its path if two stems are equal."""
    stems = [output_name(picture.stem) for picture in pictures]
    names = stems if len(set(stems)) == len(stems) else [str(picture) for picture in pictures]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(twice, "is given twice", "each picture once")
    return names
