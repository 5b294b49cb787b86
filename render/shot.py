"""Content of one image: camera, pose, markers, motion and occluders."""

from collections.abc import Sequence
from dataclasses import dataclass

from skyherd.geometry import Array, IntArray
from skyherd.render.camera.camera import Camera, CameraPose
from skyherd.render.camera.motion import STILL, Motion
from skyherd.render.scene.occluders import Occluder


@dataclass(frozen=True, eq=False)
class Shot:
    """One image: a camera and the markers in front of it.

    Attributes:
        camera: intrinsics and lens.
        pose: pose of the camera in the middle of the exposure of the middle row.
        ids: (N,) markers of the dictionary.
        positions_m: (N, 2) marker centres on the ground.
        headings_rad: (N,) forward directions of the markers, counter-clockwise from +x.
        motion: velocities of camera and robots; without effect if exposure and row time are 0.
        occluders: shapes over the markers, in drawing order.
        stream: number of the camera's video stream; without effect unless the sensor compresses video.
    """

    camera: Camera
    pose: CameraPose
    ids: IntArray
    positions_m: Array
    headings_rad: Array
    motion: Motion = STILL
    occluders: Sequence[Occluder] = ()
    stream: int = 0
