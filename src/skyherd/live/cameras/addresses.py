"""Addresses of cameras."""

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
from skyherd.live.cameras.ros2 import Ros2Camera
from skyherd.live.cameras.streams import device_of, stream_of

Pace = Literal["own", "fast"]
"""Playback of recordings: `own` at the recorded frame rate, `fast` as fast as the user takes pictures."""

PLUGIN = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*(=.*)?", re.DOTALL)
"""`module:factory`, optionally with `=TEXT`."""

ALLOWED = "/dev/video0, rtsp://…, http://…, udp://…, tcp://…, ros2://…, a video, a folder, module:factory"
"""Allowed addresses, for error messages."""


def open_camera(
    address: str, *, pace: Pace = "own", clock: Clock = time.monotonic, kept: int = 1
) -> CameraReader:
    """Open a camera and read it in a separate thread. The caller closes the returned reader.

    | address | source |
    |---|---|
    | `0`, `/dev/video0`, `/dev/video0?size=1280x720&rate=30&format=mjpeg` | a V4L2 device |
    | `rtsp://…`, `http://…`, `https://…`, `udp://…`, `tcp://…` | a stream |
    | `ros2://host/camera/image_raw`, `ros2://…?type=CompressedImage` | a topic of ROS 2 over Zenoh |
    | a file | a video |
    | a folder | new pictures as they appear; with the pace `fast` the existing ones |
    | `module:factory`, `module:factory=TEXT` | a custom source |

    Args:
        address: see above.
        pace: playback of recordings. With `own`, each picture appears when it is due, and `captured_s` is its
            due time. With `fast`, each picture waits until the user has taken the previous one, and none is
            dropped; `captured_s` is the recording's time since opening, which may be ahead of the clock.
        clock: returns the time of all stamps, s.
        kept: number of pictures that wait until they are taken; 1 keeps the newest.

    Raises:
        InputError: the camera cannot be opened, or did not open in time
            (`skyherd.live.cameras.reader.OPEN_S`). The error text contains no password of the address.
    """
    if pace not in ("own", "fast"):
        raise InputError("pace", repr(pace), "own or fast")
    return CameraReader(_source_of(address, pace), clock=clock, kept=kept).start()


def check_camera(address: str) -> None:
    """Refuse an address that no camera of this machine has. It opens videos, but no cameras.

    Raises:
        InputError: the address is invalid, or there is no such device, video or factory; see `open_camera`.
    """
    if isinstance(_source_of(address, "own"), VideoFile):
        open_clip(Path(address))


def _source_of(address: str, pace: Pace) -> Source:
    """Return the source of an address.

    Raises:
        InputError: the address is invalid.
    """
    if address.isdecimal():
        address = f"/dev/video{address}"
    if address.startswith("ros2://"):
        return Ros2Camera(address)
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
