"""Finds pictures and videos, and reads videos frame by frame as grey images.

Frames are upright, as the video's tag says that the camera was held, and have the times that the stream has
for them: cameras and phones do not keep an even rate.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.files.images import SUFFIXES

DEEPER = ("*/*", "*/*/*")
"""Where pictures are looked for, to name their folder, if there are none in the folder itself."""

FEW = 4
"""Such folders that a complaint names at most. *Chosen*: fits a line or two."""

DISPLAY_MATRIX = "DISPLAYMATRIX"
"""Name of the data beside a frame that say how it is to be turned. *Defined* by FFmpeg."""

USUAL_RATE_HZ = Fraction(25)
"""Frames a second of a video that says nothing of its rate. *Chosen*: usual, and only times depend on it."""

VIDEO_SUFFIXES = frozenset(
    {".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".ts", ".mts", ".wmv"}
)
"""How the names of video files end; any other file is taken as a picture."""


@dataclass(frozen=True)
class Frame:
    """A picture of a video.

    Attributes:
        index: its number, from 0.
        time_s: its time in the stream, at which a player shows it. Frames need not be evenly apart, nor does
            the first have to be at 0.
        image: grey levels (height, width).
    """

    index: int
    time_s: float
    image: npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Clip:
    """What is known of a video before it is read.

    Attributes:
        path: the file.
        rate_hz: frames a second.
        count: number of frames; 0 if not known.
    """

    path: Path
    rate_hz: Fraction
    count: int


def is_video(path: Path) -> bool:
    """Whether a file is a video, by the end of its name."""
    return path.suffix.lower() in VIDEO_SUFFIXES


def find_files(target: Path) -> list[Path]:
    """The file itself, or the pictures and videos in a folder, in the order of their names.

    Raises:
        InputError: there is no such file or folder, or no picture in the folder.
    """
    if not target.exists():
        raise InputError(
            str(target), "no such file or folder", "give a picture, a folder of them, or a video"
        )
    if not target.is_dir():
        return [target]
    known = SUFFIXES | VIDEO_SUFFIXES
    found = [file for file in target.iterdir() if file.is_file() and file.suffix.lower() in known]
    if not found:
        deeper = {
            file.parent for level in DEEPER for file in target.glob(level) if file.suffix.lower() in known
        }
        allowed = f"names that end in {', '.join(sorted(known))}"
        if deeper:
            allowed = f"the folder that they are in: {', '.join(sorted(map(str, deeper))[:FEW])}"
        raise InputError(str(target), "no picture in this folder", allowed)
    return sorted(found, key=lambda file: file.name)


def open_clip(path: Path) -> Clip:
    """Open a video to find its rate and length; nothing stays open.

    Raises:
        InputError: it is not a video that can be read.
    """
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            rate = stream.average_rate or stream.guessed_rate or USUAL_RATE_HZ
            seconds = float((container.duration or 0) / av.time_base)
            return Clip(path, Fraction(rate), stream.frames or round(seconds * float(rate)))
    except (OSError, av.FFmpegError, IndexError) as error:
        raise _unreadable(path, error) from None


def read_clip(clip: Clip) -> Iterator[Frame]:
    """Read the frames of a video, one at a time.

    Raises:
        InputError: it cannot be read to its end, or has no frame.
    """
    index = 0
    time_s = 0.0
    try:
        with av.open(str(clip.path)) as container:
            for picture in container.decode(video=0):
                own_s: Any = picture.time
                if own_s is not None:
                    time_s = float(own_s)
                elif index:
                    time_s += float(1 / clip.rate_hz)
                grey = np.asarray(picture.to_ndarray(format="gray"), dtype=np.uint8)
                yield Frame(index, time_s, np.ascontiguousarray(_upright(grey, picture)))
                index += 1
    except (OSError, av.FFmpegError, IndexError) as error:
        raise _unreadable(clip.path, error) from None
    if not index:
        raise _unreadable(clip.path, None)


def _upright(image: npt.NDArray[np.uint8], picture: av.VideoFrame) -> npt.NDArray[np.uint8]:
    """The image (height, width) as the display matrix of its frame turns and mirrors it, by quarter turns.

    The matrix (a, b, ., c, d, ., ...) takes the point (u, v) to (a u + c v, b u + d v), and what is then
    negative back into view. Of angles in between, the nearest quarter turn is taken.
    """
    data: Any = picture.side_data.get(DISPLAY_MATRIX)
    if data is None:
        return image
    a, b, _, c, d = np.frombuffer(bytes(data), dtype=np.int32)[:5].tolist()
    if abs(b) + abs(c) > abs(a) + abs(d):
        image, a, d = image.T, c, b
    return image[:: -1 if d < 0 else 1, :: -1 if a < 0 else 1]


def _unreadable(path: Path, error: Exception | None) -> InputError:
    why = (
        "no picture in it"
        if error is None
        else " ".join(str(getattr(error, "strerror", None) or error).split())
    )
    return InputError(str(path), f"cannot be read as a video ({why})", "give one that plays, such as an MP4")
