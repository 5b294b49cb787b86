"""Search for pictures and videos, and reading of videos frame by frame as grey images.

Frames are upright according to the video's orientation tag, and have the time stamps of the stream, since
cameras and phones do not keep a constant rate. A truncated or damaged video is read as far as possible, with
an `InputWarning` at its end.
"""

import re
import warnings
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError, InputWarning, OutputError
from skyherd.files.images import MAX_PIXELS, SUFFIXES
from skyherd.files.reading import is_regular, open_regular
from skyherd.files.upright_grey import UprightGrey

DEEPER = ("*/*", "*/*/*")
"""Subfolder patterns that are searched for pictures, to suggest a folder if it has none itself."""

FEW = 4
"""Maximum number of such folders in an error message. *Chosen*: fits a line or two."""

USUAL_RATE_HZ = Fraction(25)
"""Frame rate of a video that states none, Hz. *Chosen*: usual, and only times depend on it."""

VIDEO_SUFFIXES = frozenset(
    {".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".ts", ".mts", ".wmv"}
)
"""Suffixes of video files; any other file is read as a picture."""


CONTAINERS = ("mov", "mp4", "avi", "matroska", "webm", "mpeg", "mpegvideo", "mpegts", "asf", "h264", "hevc")
"""FFmpeg formats that a video file may have, whatever its name. *Chosen*: those of `VIDEO_SUFFIXES`. FFmpeg
has hundreds, some of which (playlists) open other files and addresses."""

OPTIONS = {"format_whitelist": ",".join(CONTAINERS), "protocol_whitelist": "file"}
"""FFmpeg options for opening a video."""

UNSTATED = ("mpegvideo", "h264", "hevc", "m4v", "mpeg", "mpegts")
"""Formats without a stated length: FFmpeg measures or guesses it."""

DURATION = re.compile(r"(\d{1,9}):(\d{1,9}):(\d{1,9}(?:\.\d{1,9})?)")
"""Tag of a Matroska stream with its end time. *Defined* by FFmpeg, which writes it."""

MAX_MISSING = 5
"""Number of missing frames above which a video counts as truncated. *Chosen*: writers round, and count frames
that a player does not show; a truncated file lacks more."""

GIVE_A_VIDEO = "give one that plays, such as an MP4"
"""Advice in error messages about videos."""


@dataclass(frozen=True)
class ClipFrame:
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
    """Properties of a video that are known before it is read.

    Attributes:
        path: the file.
        rate_hz: frames per second.
        count: number of frames; 0 if unknown.
        end_s: end time of the pictures according to the file, s; None if not stated.
        topic: topic of the images in a rosbag2 recording; None for a video.
    """

    path: Path
    rate_hz: Fraction
    count: int
    end_s: float | None = None
    topic: str | None = None


def is_video(path: Path) -> bool:
    """Return whether a file is a video, by its suffix."""
    return path.suffix.lower() in VIDEO_SUFFIXES


def find_files(target: Path) -> list[Path]:
    """Return the file itself, or the pictures and videos in a folder, sorted by name.

    Raises:
        InputError: the file or folder does not exist, or the folder has no picture.
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
    """Open a video from a regular file without its name, parts of which FFmpeg would interpret.

    Raises:
        InputError: it is not a readable video, now or in the body of the `with`.
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
    """Open a video to find its rate and length, and close it.

    Raises:
        InputError: it is not a video that can be read.
    """
    with _open_container(path) as container:
        stream = _video_stream(path, container)
        _check_size(path, stream.width, stream.height)
        rate = Fraction(stream.average_rate or stream.guessed_rate or USUAL_RATE_HZ)
        seconds = float((container.duration or 0) / av.time_base)
        count = stream.frames or round(seconds * float(rate))
        return Clip(path, rate, count, _end_s(container, stream, rate))


def _video_stream(path: Path, container: av.container.InputContainer) -> av.VideoStream:
    """Return the picture stream; InputError without one of a known codec."""
    stream = next(iter(container.streams.video), None)
    if stream is None or not hasattr(stream, "width"):
        raise _unreadable(path, None)
    return stream


def _end_s(container: av.container.InputContainer, stream: av.VideoStream, rate_hz: Fraction) -> float | None:
    """Return the stated end time of the pictures; None if unstated, or stated only together with sound."""
    kind = container.format.name
    if kind in UNSTATED:
        return None
    if kind == "avi" and stream.frames:  # of a part of a file, FFmpeg gives the duration of that part
        return float(stream.frames / rate_hz)
    if stream.duration is not None and stream.time_base is not None:
        return float((stream.duration + (stream.start_time or 0)) * stream.time_base)
    if (tag := DURATION.fullmatch(stream.metadata.get("DURATION", ""))) is not None:
        return 3600 * float(tag[1]) + 60 * float(tag[2]) + float(tag[3])
    if container.duration and len(container.streams) == 1:
        return float(container.duration / av.time_base)
    return None


def _check_size(path: Path, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        what = f"{width}x{height} px a picture"
        raise InputError(str(path), what, f"at most {MAX_PIXELS / 1e6:.0f} megapixels can be read")


def read_clip(clip: Clip) -> Generator[ClipFrame]:
    """Read the frames of a video, one at a time, as far as possible.

    Warns with `InputWarning` at the end if the video is damaged, or shorter than its file says.

    Raises:
        InputError: no frame can be read.
    """
    index, first_s, time_s, frame_s = 0, 0.0, 0.0, float(1 / clip.rate_hz)
    grey, damage = UprightGrey(), _Damage()
    with _open_container(clip.path) as container:
        stream = _video_stream(clip.path, container)
        for picture in _pictures(container, stream, damage):
            _check_size(clip.path, picture.width, picture.height)
            own_s: Any = picture.time
            if own_s is not None:
                time_s = float(own_s)
            elif index:
                time_s += frame_s
            first_s = first_s if index else time_s
            yield ClipFrame(index, time_s, grey.of(picture))
            index += 1
    if not index:
        raise _unreadable(clip.path, damage.error)
    end_s = time_s + frame_s
    if damage.found or (clip.end_s is not None and clip.end_s - end_s > MAX_MISSING * frame_s):
        whole = "" if clip.end_s is None else f" of {clip.end_s - first_s:.1f} s"
        what = f"cut short or damaged: {index} frames, {end_s - first_s:.1f} s{whole}"
        warnings.warn(InputWarning(f"{clip.path}: {what}"), stacklevel=2)


@dataclass
class _Damage:
    """Record of read or decode errors of a stream, with the last error."""

    found: bool = False
    error: Exception | None = None


def _pictures(
    container: av.container.InputContainer, stream: av.VideoStream, damage: _Damage
) -> Iterator[av.VideoFrame]:
    """Yield the decodable pictures of a stream as far as it can be read; note the damage."""
    try:
        for packet in container.demux(stream):
            damage.found |= packet.is_corrupt
            pictures = _decoded(packet, damage)
            while pictures:  # none is held here while it is looked at
                damage.found |= pictures[-1].is_corrupt
                yield pictures.pop()
    except av.FFmpegError as error:
        damage.found, damage.error = True, error


def _decoded(packet: Any, damage: _Damage) -> list[av.VideoFrame]:
    """Return the pictures that a packet completes, the last first; none if it cannot be decoded."""
    try:
        pictures: list[av.VideoFrame] = packet.decode()
        return pictures[::-1]
    except av.FFmpegError as error:
        damage.found, damage.error = True, error
        return []


def _unreadable(path: Path, error: Exception | None) -> InputError:
    why = (
        "it has no picture"
        if error is None
        else " ".join(str(getattr(error, "strerror", None) or error).split())
    )
    return InputError(str(path), f"cannot be read as a video ({why})", GIVE_A_VIDEO)
