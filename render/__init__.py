"""Rendered images of a team of marked robots from above, with exact ground truth.

`Renderer` draws the grey image of a `Shot`: textured ground with clutter, marker cards and occluders. It
models lens, shutter, sensor noise and the camera's image processing. `project_markers` and `Renderer.truth`
return the ground truth of the same image. The package does not depend on detectors or controllers.

Rendering is exact, not supersampled. Each pixel sums, in closed form, the grey steps at the grid lines of a
card near it, by their distances in the image (`render/native/lattices.c`). The edge spread function of lens
blur and square pixels is a table (`skyherd.render.edge`). Tilt, perspective, lens and
rolling shutter only change the pixel's position on the card and its distance to each line. Markers are
neither filtered nor resampled. The error against an independent supersampled reference
(`tests/helpers/reference.py`) is at most 0.2 grey levels of 200, and 0.04 RMS.
"""

from skyherd.render.camera.camera import (
    Camera,
    CameraPose,
    footprint_m,
    homography_image_ground,
    project,
    rotation_camera_world,
    undistort,
)
from skyherd.render.camera.fisheye import Equidistant
from skyherd.render.camera.lens import Distortion
from skyherd.render.camera.lens_blur import LensBlur
from skyherd.render.camera.motion import Motion, Shutter
from skyherd.render.ground import Ground
from skyherd.render.processing.development import Processing
from skyherd.render.processing.mosaic import Mosaic
from skyherd.render.renderer import Renderer
from skyherd.render.scene.clutter import Clutter
from skyherd.render.scene.occluders import Disc, Quad
from skyherd.render.sensor import Illumination, Sensor
from skyherd.render.shot import Imaging, Shot
from skyherd.render.team_projection import TeamImage, project_team
from skyherd.render.truth import FrameTruth, project_markers

__all__ = [
    "Camera",
    "CameraPose",
    "Clutter",
    "Disc",
    "Distortion",
    "Equidistant",
    "FrameTruth",
    "Ground",
    "Illumination",
    "Imaging",
    "LensBlur",
    "Mosaic",
    "Motion",
    "Processing",
    "Quad",
    "Renderer",
    "Sensor",
    "Shot",
    "Shutter",
    "TeamImage",
    "footprint_m",
    "homography_image_ground",
    "project",
    "project_markers",
    "project_team",
    "rotation_camera_world",
    "undistort",
]
