"""Positions and poses in metres, where a marker's side or a camera's calibration is known.

`control` never uses this package: the controller sees pixels alone. With the side of the markers,
`ground_positions` gives positions on the ground plane of a rectified image. With a `Calibration`,
`marker_poses` gives poses in the camera's axes. `common_frame` and `locate_camera` give those of markers and
cameras in one frame.
"""

from skyherd.poses.calibration import Calibration
from skyherd.poses.calibration_files import calibration_of, read_calibration
from skyherd.poses.camera_poses import CameraPoses, camera_poses
from skyherd.poses.common_frame import CommonFrame, View, common_frame, locate_camera
from skyherd.poses.ground import check_side, ground_covariances, ground_positions, recording_scales
from skyherd.poses.marker_poses import MarkerPoses, marker_poses

__all__ = [
    "Calibration",
    "CameraPoses",
    "CommonFrame",
    "MarkerPoses",
    "View",
    "calibration_of",
    "camera_poses",
    "check_side",
    "common_frame",
    "ground_covariances",
    "ground_positions",
    "locate_camera",
    "marker_poses",
    "read_calibration",
    "recording_scales",
]
