"""Poses of the markers of one image in the camera's axes, of single markers or of all on one plane."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit

from skyherd.geometry import Array
from skyherd.poses.calibration import Calibration
from skyherd.poses.common_frame import View, common_frame
from skyherd.poses.marker_poses import MarkerPoses, marker_poses


class CameraPoses(NamedTuple):
    """Poses of N markers in the camera's axes.

    Attributes:
        rotations: (N, 3, 3) from the marker's axes to the camera's.
        translations_m: (N, 3) positions of the markers' centres.
        covariances: (N, 6, 6) of position, m, and rotation, rad; see `skyherd.poses.marker_poses`.
        alone: the poses of single markers; None if all markers were placed on one plane.
    """

    rotations: Array
    translations_m: Array
    covariances: Array
    alone: MarkerPoses | None

    def total_covariances(self) -> Array:
        """Return the covariances (N, 6, 6) that include the error of the wrong solution of a single marker.

        With the probability w of the other pose, at the difference d from the reported one, the mean squared
        error of the reported pose is (1 - w) C + w (C + d dᵀ). It holds where both solutions are distinct;
        nearer to the frontal pose it is still too small.
        """
        if self.alone is None:
            return self.covariances
        turns = self.alone.other_rotations @ np.swapaxes(self.rotations, 1, 2)
        shifts = self.alone.other_translations_m - self.translations_m
        differences = np.concatenate([shifts, Rotation.from_matrix(turns).as_rotvec()], axis=1)
        others = expit(-self.alone.log_ratios)[:, None, None]
        outer = differences[:, :, None] * differences[:, None, :]
        return np.asarray(self.covariances + others * outer)


def camera_poses(
    corners_px: Array, corner_covariances: Array, calibration: Calibration, side_m: float, *, one_plane: bool
) -> CameraPoses:
    """Return the poses of an image's markers, from their corners (N, 4, 2) and covariances (N, 8, 8).

    Args:
        corners_px: corners, px.
        corner_covariances: their covariances, px².
        calibration: of the camera.
        side_m: side of the markers.
        one_plane: whether all markers lie on one plane.
    """
    poses = marker_poses(corners_px, corner_covariances, calibration, side_m)
    if one_plane and len(poses.rotations) > 1:
        # Numbers for ids, since an id may be found twice.
        view = View("image", calibration, np.arange(len(corners_px)), corners_px, corner_covariances)
        plane = common_frame([view], side_m, coplanar=True)
        if plane.consistent:
            return CameraPoses(*plane.in_camera(0), None)
    return CameraPoses(poses.rotations, poses.translations_m, poses.covariances, poses)
