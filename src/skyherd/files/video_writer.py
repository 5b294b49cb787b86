"""Writing of browser-compatible video files, each verified before it gets its name.

Frames go to a temporary file. On close, it is read back and its frames are counted. Only a complete file with
all written frames gets its final name.
"""

import os
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Self

import av
import cv2
import numpy as np

from skyherd.errors import OutputError
from skyherd.files.atomic import part_of
from skyherd.geometry import RgbImage

QUALITY = {"crf": "23", "preset": "veryfast", "x264-params": "subme=1:analyse=none:b-adapt=0"}
"""Settings of libx264: constant quality, and fast enough for the loop. *Measured* on 101 frames of `star`,
1600x1000: the last setting takes 9 ms a frame, its absence 15 ms, `superfast` 10 ms at twice the size."""

THREADS = 2
"""Number of encoding threads. *Chosen*: keeps up with the loop, and leaves the other cores free."""

BT709 = 1
"""Primaries and transfer of HD video, the default of players. *Defined*: their number in FFmpeg."""

BT601 = 6
"""Matrix from RGB to luma and chroma, as OpenCV converts; the file names it. *Defined*: its number in FFmpeg.
*Measured*: a frame of 1600x1000 takes OpenCV 0.6 ms, FFmpeg 5 ms."""

STUDIO_RANGE = 1
"""Levels from 16 to 235, the default of players. *Defined*: their number in FFmpeg."""

TICK_S = Fraction(1, 90_000)
"""Time unit of frames with their own time stamps, s. *Chosen*: usual in video; constant rates fit into it to
1e-5 s."""

MAX_DENOMINATOR = 10_000
"""Maximum denominator of a rate. *Chosen*: holds 30000/1001 and the like exactly, and fits the container's
time base."""


class VideoSink:
    """H.264 video of RGB frames: `with VideoSink(path, (1600, 1000), 10) as sink: sink.write(frame)`.

    Frames go to a temporary file, `part`. It replaces `path` only when complete: closed, read back, and with
    as many frames as were written. If the body raises, nothing is left behind.

    Attributes:
        path: the file to make.
        size_px: width and height of every frame.
        rate_hz: frames per second.
        frames: number of frames written so far.
        part: the temporary file.

    Args:
        path: the file to make, an MP4.
        size_px: width and height of every frame, both even.
        rate_hz: frames per second; fractions such as `Fraction(30000, 1001)` are kept exactly.
        timed: write each frame with its own time stamp; the rate is then only nominal.

    Raises:
        OutputError: at once, if the file cannot be created there; or later, if a frame has a wrong format or
            the file is incomplete.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        size_px: tuple[int, int],
        rate_hz: Fraction | float,
        *,
        timed: bool = False,
    ) -> None:
        self.path, self.size_px = Path(path), size_px
        self.rate_hz = _checked_rate(self.path, rate_hz)
        self.frames, self.timed = 0, timed
        self._first_s, self._last_tick = 0.0, -1
        self.part = part_of(self.path)
        self._claim_target()
        self._container = av.open(str(self.part), "w", format="mp4", options={"movflags": "+faststart"})
        self._stream = self._add_stream()
        self._open = True

    def write(self, frame: RgbImage, time_s: float = 0.0) -> None:
        """Append one frame, (height, width, 3) uint8 RGB; the array may be changed afterwards.

        Args:
            frame: the picture.
            time_s: its time stamp, in timed videos. The first is shown at 0. A frame that is not later than
                its predecessor is shown right after it.

        Raises:
            OutputError: the sink is closed, the frame has another size or type, or the disk is full.
        """
        width, height = self.size_px
        if not self._open:
            raise OutputError(f"{self.path}: is closed; write frames before closing it")
        if frame.shape != (height, width, 3) or frame.dtype != np.uint8:
            raise OutputError(
                f"{self.path}: frame {self.frames} is {frame.shape} {frame.dtype}, "
                f"expected {(height, width, 3)} uint8"
            )
        planes = np.asarray(cv2.cvtColor(frame, cv2.COLOR_RGB2YUV_I420), dtype=np.uint8)
        picture = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        picture.pts, picture.time_base = self._pts(time_s), TICK_S if self.timed else 1 / self.rate_hz
        self._mux(picture)
        self.frames += 1

    def _pts(self, time_s: float) -> int:
        """Return the frame's time stamp in units of its time base."""
        if not self.timed:
            return self.frames
        if not self.frames:
            self._first_s = time_s
        self._last_tick = max(round((time_s - self._first_s) / TICK_S), self._last_tick + 1)
        return self._last_tick

    def close(self) -> None:
        """Finish the file, verify it and rename it; closing twice does nothing.

        Raises:
            OutputError: no frame was written, or the file is incomplete; nothing is left of it.
        """
        if not self._open:
            return
        try:
            if not self.frames:
                raise OutputError(f"{self.path}: no frames were written; a video needs at least one")
            self._mux(None)
            self._container.close()
            found = count_frames(self.part)
            if found != self.frames:
                raise OutputError(f"{self.path}: holds {found} frames, but {self.frames} were written")
            os.replace(self.part, self.path)
        except (OSError, av.FFmpegError) as error:
            self.abort()
            if isinstance(error, OutputError):
                raise
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from None
        self._open = False

    def abort(self) -> None:
        """Close and remove the temporary file; an earlier file stays as it was."""
        self._open = False
        with suppress(OSError, av.FFmpegError):
            self._container.close()
        self.part.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            self.abort()

    def _claim_target(self) -> None:
        """Create the temporary file, so that an unwritable location is rejected at once."""
        if any(side < 2 or side % 2 for side in self.size_px):
            raise OutputError(f"{self.path}: size {self.size_px} px, but both sides of a video must be even")
        if not self.path.parent.is_dir():
            raise OutputError(f"{self.path}: no folder {self.path.parent}; make it first")
        try:
            self.part.write_bytes(b"")
            is_folder = self.path.is_dir()
        except OSError as error:
            self.part.unlink(missing_ok=True)
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from None
        if is_folder:
            self.part.unlink()
            raise OutputError(f"{self.path}: is a folder; name a file in it")

    def _add_stream(self) -> av.VideoStream:
        stream = self._container.add_stream("libx264", rate=self.rate_hz, options=QUALITY)
        stream.width, stream.height = self.size_px
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        if self.timed:
            context.time_base = TICK_S
        context.thread_count = THREADS
        context.colorspace, context.color_primaries, context.color_trc = BT601, BT709, BT709
        context.color_range = STUDIO_RANGE
        return stream

    def _mux(self, picture: av.VideoFrame | None) -> None:
        try:
            self._container.mux(self._stream.encode(picture))
        except av.FFmpegError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from None


def _checked_rate(path: Path, rate_hz: Fraction | float) -> Fraction:
    try:
        rate = Fraction(rate_hz).limit_denominator(MAX_DENOMINATOR)
    except (ValueError, OverflowError):
        rate = Fraction(0)
    if rate <= 0:
        raise OutputError(f"{path}: {rate_hz} frames a second; must be positive and finite")
    return rate


def count_frames(path: str | os.PathLike[str]) -> int:
    """Count the frames of a video file packet by packet, without decoding."""
    with av.open(str(path)) as container:
        return sum(1 for packet in container.demux(video=0) if packet.size)


def read_frames(path: str | os.PathLike[str]) -> Iterator[RgbImage]:
    """Read the frames of a video file, one at a time: (height, width, 3) uint8 RGB.

    Raises:
        OutputError: the file is not a video that can be read.
    """
    try:
        with av.open(str(path)) as container:
            for frame in container.decode(video=0):
                yield np.asarray(frame.to_ndarray(format="rgb24"), dtype=np.uint8)
    except (OSError, av.FFmpegError, IndexError) as error:
        raise OutputError(f"{path}: cannot be read as a video: {error}") from None


def read_last_frame(path: str | os.PathLike[str]) -> RgbImage:
    """Read the last frame of a video file: (height, width, 3) uint8 RGB.

    Only the frames from the last key frame on are decoded.

    Raises:
        OutputError: the file is not a video that can be read.
    """
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            container.seek(stream.duration or 0, stream=stream)
            *_, last = container.decode(stream)
            return np.asarray(last.to_ndarray(format="rgb24"), dtype=np.uint8)
    except (OSError, av.FFmpegError, IndexError, ValueError) as error:
        raise OutputError(f"{path}: cannot be read as a video: {error}") from None
