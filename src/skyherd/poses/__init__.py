"""Positions and poses in metres, where a marker's side or a camera's calibration is known.

`control` never uses this package: the controller sees pixels alone. With the side of the markers,
`ground_positions` gives positions on the ground plane of a rectified image.
"""

from skyherd.poses.ground import check_side, ground_covariances, ground_positions

__all__ = [
    "check_side",
    "ground_covariances",
    "ground_positions",
]
