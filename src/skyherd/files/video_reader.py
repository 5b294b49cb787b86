"""Finds pictures and videos, and reads videos frame by frame as grey images.

Frames are upright, as the video's tag says that the camera was held, and have the times that the stream has
for them: cameras and phones do not keep an even rate.
"""

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt
from av.video.reformatter import Interpolation, VideoReformatter

from skyherd.errors import InputError, OutputError
from skyherd.files.images import MAX_PIXELS, SUFFIXES
from skyherd.files.reading import is_regular, open_regular

DEEPER = ("*/*", "*/*/*")
"""Where pictures are looked for, to name their folder, if there are none in the folder itself."""

FEW = 4
"""Such folders that a complaint names at most. *Chosen*: fits a line or two."""

DISPLAY_MATRIX = "DISPLAYMATRIX"
"""Name of the data beside a frame that say how it is to be turned. *Defined* by FFmpeg."""

ONE_THREAD: dict[str, Any] = {"threads": 1} if int(av.__version__.split(".")[0]) >= 17 else {}
"""What PyAV is told so that it converts pictures in the thread that asks. *Measured*: 1200 x 800 px take 0.05
to 0.3 ms; from version 17 on it starts a thread for each core otherwise, and before it knows no such word."""

TAG_PX = 16
"""Sides of the picture whose tags are read in place of a frame's. *Chosen*: takes 8 microseconds, and
is of a size that any conversion takes."""

USUAL_RATE_HZ = Fraction(25)
"""Frames a second of a video that says nothing of its rate. *Chosen*: usual, and only times depend on it."""

VIDEO_SUFFIXES = frozenset(
    {".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".ts", ".mts", ".wmv"}
)
"""How the names of video files end; any other file is taken as a picture."""


CONTAINERS = ("mov", "mp4", "avi", "matroska", "webm", "mpeg", "mpegvideo", "mpegts", "asf", "h264", "hevc")
"""Formats of FFmpeg that a video file may have, whatever its name says. *Chosen*: those of `VIDEO_SUFFIXES`.
FFmpeg has hundreds, some of which (playlists) open other files and addresses."""

OPTIONS = {"format_whitelist": ",".join(CONTAINERS), "protocol_whitelist": "file"}
"""What FFmpeg is told when it opens a video."""

GIVE_A_VIDEO = "give one that plays, such as an MP4"
"""What complaints about videos advise."""


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
    if not is_regular(target) and not _is_there(target):
        raise InputError(
            str(target), "no such file or folder", "give a picture, a folder of them, or a video"
        )
    if not target.is_dir():
        return [target]
    known = SUFFIXES | VIDEO_SUFFIXES
    try:
        found = [file for file in target.iterdir() if is_regular(file) and file.suffix.lower() in known]
    except OSError as error:
        raise InputError(str(target), f"cannot be read: {error.strerror}", "a folder of pictures") from None
    if not found:
        deeper = {
            file.parent for level in DEEPER for file in target.glob(level) if file.suffix.lower() in known
        }
        allowed = f"names that end in {', '.join(sorted(known))}"
        if deeper:
            allowed = f"the folder that they are in: {', '.join(sorted(map(str, deeper))[:FEW])}"
        raise InputError(str(target), "no picture in this folder", allowed)
    return sorted(found, key=lambda file: file.name)


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


@contextmanager
def _open_container(path: Path) -> Iterator[av.container.InputContainer]:
    """A video opened from a regular file, whose name FFmpeg does not see: it would obey some names.

    Raises:
        InputError: it is no video that can be read, now or in the body of the `with`.
    """
    with open_regular(path, GIVE_A_VIDEO) as stream:
        try:
            with av.open(stream, "r", options=OPTIONS) as container:
                yield container
        except (OSError, av.FFmpegError, IndexError, ValueError) as error:
            if isinstance(error, InputError | OutputError):
                raise
            raise _unreadable(path, error) from None


def open_clip(path: Path) -> Clip:
    """Open a video to find its rate and length; nothing stays open.

    Raises:
        InputError: it is not a video that can be read.
    """
    with _open_container(path) as container:
        stream = container.streams.video[0]
        if not hasattr(stream, "width"):  # a stream whose codec is not known
            raise _unreadable(path, None)
        _check_size(path, stream.width, stream.height)
        rate = stream.average_rate or stream.guessed_rate or USUAL_RATE_HZ
        seconds = float((container.duration or 0) / av.time_base)
        return Clip(path, Fraction(rate), stream.frames or round(seconds * float(rate)))


def _check_size(path: Path, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        what = f"{width}x{height} px a picture"
        raise InputError(str(path), what, f"at most {MAX_PIXELS / 1e6:.0f} megapixels can be read")


def read_clip(clip: Clip) -> Generator[Frame]:
    """Read the frames of a video, one at a time.

    Raises:
        InputError: it cannot be read to its end, or has no frame.
    """
    index = 0
    time_s = 0.0
    grey = UprightGrey()
    with _open_container(clip.path) as container:
        for picture in container.decode(video=0):
            _check_size(clip.path, picture.width, picture.height)
            own_s: Any = picture.time
            if own_s is not None:
                time_s = float(own_s)
            elif index:
                time_s += float(1 / clip.rate_hz)
            yield Frame(index, time_s, grey.of(picture))
            index += 1
    if not index:
        raise _unreadable(clip.path, None)


class UprightGrey:
    """Turns the decoded frames of a stream into grey images, upright as their display matrix says.

    One is kept for a stream, so that what a conversion needs is set up once. Nothing of a frame stays behind:
    what it holds is given back as soon as it and its image are no longer used. PyAV's `side_data`, which has
    the matrix, makes a frame hold itself until Python looks for such circles, hundreds of frames later; so it
    is asked of a copy of `TAG_PX` pixels, which has a frame's tags without its picture.
    """

    def __init__(self) -> None:
        self._levels, self._tags = VideoReformatter(), VideoReformatter()

    def of(self, picture: av.VideoFrame) -> npt.NDArray[np.uint8]:
        """Grey levels (height, width) of a decoded frame, from 0 to 255 whatever the range of the video's."""
        grey = self._levels.reformat(picture, format="gray", **ONE_THREAD)
        tags = self._tags.reformat(
            picture,
            width=TAG_PX,
            height=TAG_PX,
            format="gray",
            interpolation=Interpolation.POINT,
            **ONE_THREAD,
        )
        image = np.asarray(grey.to_ndarray(), dtype=np.uint8)
        return np.ascontiguousarray(_upright(image, tags.side_data))


def _upright(image: npt.NDArray[np.uint8], tags: Any) -> npt.NDArray[np.uint8]:
    """The image (height, width) as the display matrix among its tags turns and mirrors it, by quarter turns.

    The matrix (a, b, ., c, d, ., ...) takes the point (u, v) to (a u + c v, b u + d v), and what is then
    negative back into view. Of angles in between, the nearest quarter turn is taken.
    """
    data: Any = tags.get(DISPLAY_MATRIX)
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
    return InputError(str(path), f"cannot be read as a video ({why})", GIVE_A_VIDEO)
