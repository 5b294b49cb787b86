"""World to pixels: images of a team of marked robots from above, and the exact truth about them.

`Renderer` draws the grey image of a `Shot`: textured ground with clutter, marker cards and occluders, seen
through lens and shutter, made noisy by the sensor, and processed by the camera. `project_markers` and
`Renderer.truth` say where each marker is in the same image. Nothing here depends on detectors or controllers.

Rendering is exact, not supersampled. Each pixel sums, in closed form, the steps of grey at the few lines of a
card's grid that reach it, by their distances in the image (`skyherd.render.raster.kernels.lattices`). How far
a line reaches, through lens blur and square pixels, is one table (`skyherd.render.raster.edge`). Tilt,
perspective, lens and rolling shutter only change where a pixel lies on the card and how far each line is from
it. Nothing is filtered or resampled. Against an independent reference (`tests/helpers/reference.py`,
supersampled) the worst pixel is off by 0.2 grey levels of 200, and the root mean square is under 0.04.
"""

from skyherd.render.camera.camera import (
    Camera,
    CameraPose,
    footprint_m,
    homography_image_ground,
    project,
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
from skyherd.render.shot import Shot
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
    "undistort",
]
