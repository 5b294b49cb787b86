"""World to pixels: cameras, markers, ground, sensor, and the truth about each image."""

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
from skyherd.render.camera.motion import Motion, Shutter
from skyherd.render.ground import Ground
from skyherd.render.renderer import Renderer
from skyherd.render.scene.clutter import Clutter
from skyherd.render.scene.occluders import Disc, Quad
from skyherd.render.sensor import Illumination, Sensor
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
    "Motion",
    "Quad",
    "Renderer",
    "Sensor",
    "Shutter",
    "TeamImage",
    "footprint_m",
    "homography_image_ground",
    "project",
    "project_markers",
    "project_team",
    "undistort",
]
