"""Devices and streams, by PyAV: V4L2, RTSP, HTTP, UDP and TCP."""

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
"""Time-outs of FFmpeg, s: until a stream is open, and until a further picture comes, after which the stream
is opened anew. *Chosen*: below `skyherd.live.cameras.reader.OPEN_S`; cameras give several a second."""

V4L2 = "video4linux2,v4l2"
"""FFmpeg's name of the devices of Linux."""

CLOCKED = frozenset({"mpegts", "nut", "rtsp", "matroska,webm", "mov,mp4,m4a,3gp,3g2,mj2", "flv", "asf", V4L2})
"""Formats whose times come from whoever made the stream. Of the others (JPEG or H.264 without a container)
FFmpeg counts pictures, which is no clock."""

FORMATS = frozenset({*CLOCKED, "sdp", "rtp", "mpjpeg", "mjpeg", "jpeg_pipe", "h264", "hevc", "m4v"})
"""Formats that a stream may have. *Chosen*: those of cameras. FFmpeg has hundreds, some of which (playlists)
open other files and addresses."""

PROTOCOLS = {
    "rtsp": ("rtsp", "rtp", "udp", "tcp"),
    "rtsps": ("rtsp", "rtsps", "rtp", "srtp", "udp", "tcp", "tls"),
    "http": ("http", "tcp"),
    "https": ("https", "http", "tls", "tcp"),
    "udp": ("udp",),
    "tcp": ("tcp",),
}
"""By scheme of an address, the protocols that FFmpeg may use for it, none of which reads a file."""

MIN_DELAY = {
    "fflags": "nobuffer",
    "flags": "low_delay",
    "analyzeduration": "1000000",
    "fpsprobesize": "2",
}
"""What FFmpeg is told so that it keeps no picture back."""

MAX_AGE_S = 10.0
"""A device's time is on our machine's clock if it lies in the past by no more than so much, s. *Chosen*: any
other clock is off by more, but for a chance in many thousand."""

DEVICE_OPTIONS = {"size": "video_size", "rate": "framerate", "format": "input_format"}
"""What may stand behind a device's name, as in `/dev/video0?size=1280x720&rate=30&format=mjpeg`, and FFmpeg's
name for it."""


@dataclass
class Stream:
    """A stream from the network, or a device.

    Attributes:
        name: what complaints call it, without a password.
        address: as FFmpeg takes it.
        options: as FFmpeg takes them.
        form: FFmpeg's name of the format; None to find out.
    """

    name: str
    address: str
    options: dict[str, str] = field(default_factory=dict)
    form: str | None = None
    lasting: ClassVar[bool] = True
    pace: ClassVar[Literal["live"]] = "live"

    @contextmanager
    def open(self, pause: Callable[[float], bool]) -> Iterator[Iterator[Picture]]:
        """See `Source.open`."""
        with self._telling(f"no answer within {OPEN_S:g} s"):
            container = av.open(
                self.address,
                "r",
                format=self.form,
                options=MIN_DELAY | self.options,
                timeout=(OPEN_S, READ_S),
            )
        try:
            with self._telling("no answer"):
                if not container.streams.video:
                    raise InputError(self.name, "no video in it", "a stream with pictures")
                stream = container.streams.video[0]
                stream.thread_type = "SLICE"  # threads by frame would each keep one back
            yield self._pictures(container, stream)
        finally:
            with suppress(av.FFmpegError):
                container.close()

    @contextmanager
    def _telling(self, timed_out: str) -> Iterator[None]:
        """Errors of FFmpeg as one clear line; what a time-out means, in words."""
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
        with self._telling(f"no picture within {READ_S:g} s"):
            for picture in container.decode(stream):
                if picture.width * picture.height > MAX_PIXELS:
                    raise InputError(self.name, f"{picture.width}x{picture.height} px", "smaller pictures")
                stream_s = float(picture.time) if clocked and picture.time is not None else None
                age_s = None
                if self.form == V4L2 and stream_s is not None:
                    age_s = age_on_this_machine(stream_s, time.monotonic())
                yield Picture(grey.of(picture), stream_s, age_s)


def age_on_this_machine(stream_s: float, now_s: float) -> float | None:
    """Age of a device's picture, s, if its driver stamps by the machine's monotonic clock; None otherwise.

    Linux' drivers do so as a rule, at the first byte or at the end of the exposure.

    Args:
        stream_s: the device's time.
        now_s: the machine's, `time.monotonic`.
    """
    age_s = now_s - stream_s
    return age_s if 0 <= age_s <= MAX_AGE_S else None


def stream_of(address: str) -> Stream:
    """The stream at an address with a scheme, such as `rtsp://camera/1`.

    Of `udp://host:port` the packets that come to this port are read, at the address `host` of this machine;
    `tcp://host:port` connects, and with `?listen` waits for whoever sends.

    Raises:
        InputError: the scheme is none of a camera, or the address names no host.
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
    """The V4L2 device `/dev/videoN`, with `?size=…&rate=…&format=…` behind it where wanted.

    Raises:
        InputError: there is no such device, or an option that is not known.
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
    """What FFmpeg or the system says, in words."""
    if isinstance(error, av.error.ExitError | TimeoutError):
        return timed_out
    if isinstance(error, av.error.EOFError):
        return "it ended"
    return " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
