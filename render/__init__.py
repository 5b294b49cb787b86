"""World to pixels: cameras, markers, ground, sensor."""

from skyherd.render.camera import (
    Camera,
    CameraPose,
    footprint_m,
    homography_image_ground,
    project,
    project_markers,
)
from skyherd.render.ground import Ground
from skyherd.render.renderer import Renderer
from skyherd.render.sensor import Sensor

__all__ = [
    "Camera",
    "CameraPose",
    "Ground",
    "Renderer",
    "Sensor",
    "footprint_m",
    "homography_image_ground",
    "project",
    "project_markers",
]
