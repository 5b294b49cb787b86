"""Which camera an address means."""

import re
import time
from pathlib import Path
from typing import Literal

from skyherd.errors import InputError
from skyherd.files.reading import is_regular
from skyherd.files.video_reader import open_clip
from skyherd.live.cameras.frame import Clock, Source
from skyherd.live.cameras.plugins import PluginCamera
from skyherd.live.cameras.reader import CameraReader
from skyherd.live.cameras.recordings import ImageFolder, VideoFile
from skyherd.live.cameras.streams import device_of, stream_of

Pace = Literal["own", "fast"]
"""How recordings are played: at their own pace, or as fast as their pictures are taken."""

PLUGIN = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*(=.*)?", re.DOTALL)
"""`module:factory`, perhaps with `=TEXT`."""

ALLOWED = "/dev/video0, rtsp://…, http://…, udp://…, tcp://…, a video, a folder of pictures, module:factory"
"""What an address may be, for complaints."""


def open_camera(address: str, *, pace: Pace = "own", clock: Clock = time.monotonic) -> CameraReader:
    """Open a camera and begin to read it in a thread of its own; close what is returned.

    | address | what it is |
    |---|---|
    | `0`, `/dev/video0`, `/dev/video0?size=1280x720&rate=30&format=mjpeg` | a V4L2 device |
    | `rtsp://…`, `http://…`, `https://…`, `udp://…`, `tcp://…` | a stream |
    | a file | a video |
    | a folder | pictures, as they come; with the pace `fast` those that are there |
    | `module:factory`, `module:factory=TEXT` | a source of one's own |

    Args:
        address: see above.
        pace: of recordings. `own`: each picture comes when it is due, and `captured_s` is when it was due.
            `fast`: each picture waits until the one before was taken, none is dropped, and `captured_s`
            counts from the opening as the recording's own time does, which may be ahead of the clock.
        clock: gives the time, s, of all stamps.

    Raises:
        InputError: it cannot be opened, or did not open in time (`skyherd.live.cameras.reader.OPEN_S`); one
            clear line, without a password that the address may contain.
    """
    if pace not in ("own", "fast"):
        raise InputError("pace", repr(pace), "own or fast")
    return CameraReader(_source_of(address, pace), clock=clock).start()


def check_camera(address: str) -> None:
    """Refuse an address that no camera of this machine has; no camera is opened, but videos are.

    Raises:
        InputError: it means nothing, or there is no such device, video or factory; see `open_camera`.
    """
    if isinstance(_source_of(address, "own"), VideoFile):
        open_clip(Path(address))


def _source_of(address: str, pace: Pace) -> Source:
    """The source that an address means.

    Raises:
        InputError: it means none.
    """
    if address.isdecimal():
        address = f"/dev/video{address}"
    if "://" in address:
        return stream_of(address)
    if address.startswith("/dev/"):
        return device_of(address)
    path = Path(address)
    try:
        if address and path.is_dir():
            return ImageFolder(path, "fast" if pace == "fast" else "live")
    except (OSError, ValueError):
        pass
    if not is_regular(path) and PLUGIN.fullmatch(address):
        return PluginCamera(address)
    if not (is_regular(path) or path.suffix):
        raise InputError("camera", f"no camera {address!r}", ALLOWED)
    return VideoFile(path, pace)
