"""What one image shows."""

from collections.abc import Sequence
from dataclasses import dataclass

from skyherd.geometry import Array, IntArray
from skyherd.render.camera.camera import Camera, CameraPose
from skyherd.render.camera.motion import STILL, Motion
from skyherd.render.scene.occluders import Occluder


@dataclass(frozen=True, eq=False)
class Shot:
    """One image: a camera, and the markers before it.

    Attributes:
        camera: intrinsics and lens.
        pose: where the camera is in the middle of the exposure of the middle row.
        ids: (N,) markers of the dictionary.
        positions_m: (N, 2) places of the markers' centres on the ground.
        headings_rad: (N,) their forward directions, counter-clockwise from +x.
        motion: velocities of camera and robots; they matter only with an exposure or a row time.
        occluders: what lies over markers, each over those before it.
        stream: number of the camera's video stream, which matters only to a codec that remembers.
    """

    camera: Camera
    pose: CameraPose
    ids: IntArray
    positions_m: Array
    headings_rad: Array
    motion: Motion = STILL
    occluders: Sequence[Occluder] = ()
    stream: int = 0
