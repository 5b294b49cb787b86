"""Cameras: the newest grey picture of a device, stream, video or folder, with its time of capture.

Start with `open_camera`. docs/live/cameras.md has the addresses.
"""

from skyherd.live.cameras.addresses import Pace, check_camera, open_camera
from skyherd.live.cameras.frame import Frame, Origin, Picture, Source
from skyherd.live.cameras.mirrored import MirrorWatch
from skyherd.live.cameras.reader import CameraReader

__all__ = [
    "CameraReader",
    "Frame",
    "MirrorWatch",
    "Origin",
    "Pace",
    "Picture",
    "Source",
    "check_camera",
    "open_camera",
]
