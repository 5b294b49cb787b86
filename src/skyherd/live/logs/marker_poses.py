"""Poses of the markers in an image of a calibrated camera, for the recording of a unit.

They do not affect decisions: a unit decides by pixels alone.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from skyherd.errors import InputError
from skyherd.geometry import Array, Image, IntArray
from skyherd.messages import Detections
from skyherd.poses import Calibration, camera_poses
from skyherd.vision import measure_outlines


@dataclass(frozen=True)
class MarkerPoses:
    """Poses of N markers in the camera's axes: x right, y down, z ahead.

    Attributes:
        captured_s: time of capture on the unit's clock.
        ids: (N,) markers.
        positions_m: (N, 3) of their centres.
        quaternions: (N, 4) of their axes, (x, y, z, w): x forward, y left, z out of the face.
        covariances: (N, 6, 6) of (δt, δθ), m and rad. They contain the doubt between the two solutions of a
            single marker.
        one_plane: True if the markers were fitted on one plane, False if each alone.
    """

    captured_s: float
    ids: IntArray
    positions_m: Array
    quaternions: Array
    covariances: Array
    one_plane: bool


@dataclass(frozen=True)
class PoseMeter:
    """Measurement of the poses of markers in the images of one camera.

    Attributes:
        calibration: intrinsics of the camera.
        side_m: side of the markers.
        dictionary: name of their dictionary.
        one_plane: whether all markers lie on one plane.
    """

    calibration: Calibration
    side_m: float
    dictionary: str
    one_plane: bool

    def trouble(self, image: Image) -> str | None:
        """Return why an image cannot be measured: it has not the calibrated size; None if it can."""
        try:
            self.calibration.check_image("calibration", (image.shape[1], image.shape[0]))
        except InputError as error:
            return str(error)
        return None

    def poses(self, image: Image, found: Detections) -> MarkerPoses:
        """Return the poses of the markers in an image (height, width), without ids that occur twice."""
        once = found.unambiguous()
        corners = measure_outlines(image, once, self.dictionary)
        poses = camera_poses(*corners, self.calibration, self.side_m, one_plane=self.one_plane)
        return MarkerPoses(
            captured_s=found.time_s,
            ids=once.ids,
            positions_m=poses.translations_m,
            quaternions=np.asarray(Rotation.from_matrix(poses.rotations).as_quat()),
            covariances=poses.total_covariances(),
            one_plane=poses.alone is None,
        )
