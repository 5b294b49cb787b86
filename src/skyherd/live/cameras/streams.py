"""Devices and streams read with PyAV: V4L2, RTSP, HTTP, UDP and TCP."""

import os
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from glob import glob
from typing import Any, ClassVar, Literal
from urllib.parse import parse_qsl, urlsplit, urlunsplit

import av

from skyherd.errors import InputError
from skyherd.files.images import MAX_PIXELS
from skyherd.files.upright_grey import UprightGrey
from skyherd.live.cameras.frame import Picture

OPEN_S, READ_S = 8.0, 5.0
"""Timeouts of FFmpeg for opening a stream and for the next picture, s. *Chosen*: below
`skyherd.live.cameras.reader.OPEN_S`; cameras deliver several pictures a second."""

V4L2 = "video4linux2,v4l2"
"""FFmpeg's name of the V4L2 input format."""

CLOCKED = frozenset({"mpegts", "nut", "rtsp", "matroska,webm", "mov,mp4,m4a,3gp,3g2,mj2", "flv", "asf", V4L2})
"""Formats with time stamps of the sender. For others (JPEG or H.264 without a container), FFmpeg numbers the
pictures instead."""

FORMATS = frozenset({*CLOCKED, "sdp", "rtp", "mpjpeg", "mjpeg", "jpeg_pipe", "h264", "hevc", "m4v"})
"""Allowed formats of a stream. *Chosen*: those of cameras. Some of FFmpeg's other formats (playlists) open
further files and addresses."""

PROTOCOLS = {
    "rtsp": ("rtsp", "rtp", "udp", "tcp"),
    "rtsps": ("rtsp", "rtsps", "rtp", "srtp", "udp", "tcp", "tls"),
    "http": ("http", "tcp"),
    "https": ("https", "http", "tls", "tcp"),
    "udp": ("udp",),
    "tcp": ("tcp",),
}
"""Protocols that FFmpeg may use, by address scheme. None of them reads a file."""

MIN_DELAY = {
    "fflags": "nobuffer",
    "flags": "low_delay",
    "analyzeduration": "1000000",
    "fpsprobesize": "2",
}
"""FFmpeg options that disable its buffering of pictures."""

MAX_AGE_S = 10.0
"""Largest age of a picture at which the device's time counts as the machine's monotonic time, s. *Chosen*:
times of other clocks fall into this range with negligible probability."""

DEVICE_OPTIONS = {"size": "video_size", "rate": "framerate", "format": "input_format"}
"""FFmpeg's names of the options of a device, as in `/dev/video0?size=1280x720&rate=30&format=mjpeg`."""


@dataclass
class Stream:
    """A stream from the network, or a device.

    Attributes:
        name: name in error messages, without a password.
        address: address for FFmpeg.
        options: options for FFmpeg.
        form: FFmpeg's name of the format; None to detect it.
    """

    name: str
    address: str
    options: dict[str, str] = field(default_factory=dict)
    form: str | None = None
    lasting: ClassVar[bool] = True
    pace: ClassVar[Literal["live"]] = "live"

    @contextmanager
    def open(self, pause: Callable[[float], bool]) -> Iterator[Iterator[Picture]]:
        """Open the stream; see `Source.open`."""
        with self._input_errors(f"no answer within {OPEN_S:g} s"):
            container = av.open(
                self.address,
                "r",
                format=self.form,
                options=MIN_DELAY | self.options,
                timeout=(OPEN_S, READ_S),
            )
        try:
            with self._input_errors("no answer"):
                if not container.streams.video:
                    raise InputError(self.name, "no video in it", "a stream with pictures")
                stream = container.streams.video[0]
                stream.thread_type = "SLICE"  # Frame threads would each delay one picture.
            yield self._pictures(container, stream)
        finally:
            with suppress(av.FFmpegError):
                container.close()

    @contextmanager
    def _input_errors(self, timed_out: str) -> Iterator[None]:
        """Raise errors of FFmpeg as InputError. `timed_out` is the text of a timeout."""
        try:
            yield
        except InputError:
            raise
        except (OSError, av.FFmpegError, ValueError) as error:
            raise InputError(
                self.name, _why(error, timed_out), "a camera that can be reached and sends video"
            ) from None

    def _pictures(self, container: Any, stream: Any) -> Iterator[Picture]:
        clocked, grey = container.format.name in CLOCKED, UprightGrey()
        with self._input_errors(f"no picture within {READ_S:g} s"):
            for picture in container.decode(stream):
                if picture.width * picture.height > MAX_PIXELS:
                    raise InputError(self.name, f"{picture.width}x{picture.height} px", "smaller pictures")
                stream_s = float(picture.time) if clocked and picture.time is not None else None
                age_s = None
                if self.form == V4L2 and stream_s is not None:
                    age_s = age_on_this_machine(stream_s, time.monotonic())
                yield Picture(grey.of(picture), stream_s, age_s)


def age_on_this_machine(stream_s: float, now_s: float) -> float | None:
    """Return the age of a device's picture, s, or None if the driver does not use the monotonic clock.

    Most Linux drivers stamp with the monotonic clock, at the first byte or at the end of the exposure.

    Args:
        stream_s: time of the device.
        now_s: time of the machine, `time.monotonic`.
    """
    age_s = now_s - stream_s
    return age_s if 0 <= age_s <= MAX_AGE_S else None


def stream_of(address: str) -> Stream:
    """Return the stream at an address with a scheme, such as `rtsp://camera/1`.

    `udp://host:port` receives packets at this port of the local address `host`. `tcp://host:port` connects to
    a sender, and with `?listen` waits for one.

    Raises:
        InputError: the scheme is not supported, or the address names no host.
    """
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise InputError("camera", f"{address!r}: {error}", "an address such as rtsp://host/stream") from None
    scheme = parts.scheme.lower()
    name = urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2], query=""))
    if scheme not in PROTOCOLS:
        raise InputError("camera", f"no address {name!r}", f"one of {', '.join(PROTOCOLS)}, a device, a file")
    if not host or (scheme in ("udp", "tcp") and port is None):
        raise InputError(
            "camera", f"{name!r} lacks a host or a port", f"write it as {scheme}://127.0.0.1:5000"
        )
    options = {
        "protocol_whitelist": ",".join(PROTOCOLS[scheme]),
        "format_whitelist": ",".join(sorted({name for form in FORMATS for name in form.split(",")})),
    }
    if scheme.startswith("rtsp"):
        options["rtsp_transport"] = dict(parse_qsl(parts.query)).get("transport", "tcp")
        parts = parts._replace(query="") if "transport=" in parts.query else parts
    if scheme == "udp":
        options |= {"overrun_nonfatal": "1", "fifo_size": "20000"}
        if not host.startswith("2") or not 224 <= int(host.partition(".")[0]) < 240:
            options["localaddr"] = host
    return Stream(name, urlunsplit(parts), options)


def device_of(address: str) -> Stream:
    """Return the V4L2 device `/dev/videoN`, optionally with `?size=…&rate=…&format=…`.

    Raises:
        InputError: the device does not exist, or an option is unknown.
    """
    path, _, query = address.partition("?")
    options = {}
    for key, value in parse_qsl(query, keep_blank_values=True):
        if key not in DEVICE_OPTIONS or not value:
            raise InputError(address, f"option {key}={value}", f"{', '.join(DEVICE_OPTIONS)}")
        options[DEVICE_OPTIONS[key]] = value
    try:
        there = stat.S_ISCHR(os.stat(path).st_mode)
    except (OSError, ValueError):
        there = False
    if not there:
        devices = ", ".join(sorted(glob("/dev/video*"))) or "none on this machine"
        raise InputError(path, "no such camera", f"devices that are there: {devices}")
    return Stream(path, path, options, V4L2)


def _why(error: Exception, timed_out: str) -> str:
    """Return the text of an error of FFmpeg or the operating system."""
    if isinstance(error, av.error.ExitError | TimeoutError):
        return timed_out
    if isinstance(error, av.error.EOFError):
        return "it ended"
    return " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
