"""Content of one image: camera, pose, markers, motion, occluders, and values of this camera alone."""

from collections.abc import Sequence
from dataclasses import dataclass

from skyherd.geometry import Array, IntArray
from skyherd.render.camera.camera import Camera, CameraPose
from skyherd.render.camera.motion import STILL, Motion
from skyherd.render.scene.occluders import Occluder


@dataclass(frozen=True)
class Imaging:
    """Values of one camera instead of those of the renderer; None keeps the renderer's value.

    Attributes:
        psf_px: standard deviation of the lens's Gaussian blur.
        noise: standard deviation of the noise independent of light, grey levels.
        exposure_s: exposure time of each row.
        gain: grey levels out for each grey level of light.
    """

    psf_px: float | None = None
    noise: float | None = None
    exposure_s: float | None = None
    gain: float | None = None


STANDARD = Imaging()
"""All values are those of the renderer."""


@dataclass(frozen=True, eq=False)
class Shot:
    """One image: a camera and the markers in front of it.

    Attributes:
        camera: intrinsics and lens.
        pose: pose of the camera in the middle of the exposure of the middle row.
        ids: (N,) markers of the dictionary.
        positions_m: (N, 2) marker centres on the ground; with `frames`, the reference points of their robots.
        headings_rad: (N,) forward directions of the markers, counter-clockwise from +x; with `frames`, of
            their robots.
        motion: velocities of camera and robots; without effect if exposure and row time are 0.
        occluders: shapes over the markers, in drawing order.
        stream: number of the camera, which has its own video stream and its own `imaging`.
        imaging: values of this camera instead of those of the renderer.
        frames: (N, 3, 3) places of the markers on robots: columns are the forward axis, the left axis and the
            centre in the robot's frame (forward, left, up), marker sides. Markers are drawn in their order,
            whether or not they face the camera (`facing_rows`). None for markers flat on the ground.
    """

    camera: Camera
    pose: CameraPose
    ids: IntArray
    positions_m: Array
    headings_rad: Array
    motion: Motion = STILL
    occluders: Sequence[Occluder] = ()
    stream: int = 0
    imaging: Imaging = STANDARD
    frames: Array | None = None
