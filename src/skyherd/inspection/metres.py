"""Columns in metres of the table of detections, by the markers' side or a calibration."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from skyherd.control import Rectifier, rectified
from skyherd.geometry import Image, wrap_angle
from skyherd.messages import Detections
from skyherd.poses import (
    Calibration,
    CameraPoses,
    camera_poses,
    ground_covariances,
    ground_positions,
)
from skyherd.vision import measure_outlines

GROUND_COLUMNS = ["x_m", "y_m", "yaw_deg", "std_x_m", "std_y_m"]
"""Columns of positions on the ground plane; standard deviations are empty where the detector states none."""

AXES = "xyz"

POSE_COLUMNS = [
    *(f"camera_{axis}_m" for axis in AXES),
    *(f"turn_{axis}_rad" for axis in AXES),
    *(f"std_camera_{axis}_m" for axis in AXES),
    *(f"std_turn_{axis}_rad" for axis in AXES),
    *("pose", "log_ratio"),
]
"""Columns of poses in the camera's axes: position, rotation vector, standard deviations; whether the pose is
of the marker `alone` or of the common `plane`; log-likelihood ratio to the other solution, if alone."""


class MetricColumns:
    """Measurements in metres of the markers of one file, whose images are given in order.

    Args:
        side_m: side of the markers.
        calibration: of the camera; None for positions on the ground plane.
        one_plane: whether all markers lie on one plane, for poses by a calibration.
        border_bits: width of the markers' black border in cells.
        inverted: True for white markers on black.
    """

    def __init__(
        self,
        side_m: float,
        calibration: Calibration | None = None,
        *,
        one_plane: bool = False,
        border_bits: int = 1,
        inverted: bool = False,
    ) -> None:
        self._side_m, self._calibration, self._one_plane = side_m, calibration, one_plane
        self._border_bits, self._inverted = border_bits, inverted
        self._rectifier = Rectifier()

    def rows(self, where: str, image: Image, found: Detections, dictionary: str) -> Sequence[dict[str, Any]]:
        """Return the values of the columns for each marker of the next image.

        Raises:
            InputError: the image has not the size that the camera is calibrated for; `where` names the file.
        """
        if self._calibration is None:
            return self._ground_rows(found)
        self._calibration.check_image(where, (image.shape[1], image.shape[0]))
        corners = measure_outlines(
            image, found, dictionary, border_bits=self._border_bits, inverted=self._inverted
        )
        return _pose_rows(camera_poses(*corners, self._calibration, self._side_m, one_plane=self._one_plane))

    def _ground_rows(self, found: Detections) -> list[dict[str, Any]]:
        self._rectifier.rectify(found.unambiguous())
        flat = rectified(found, self._rectifier.ground_map)
        positions = ground_positions(flat, self._side_m)
        stds = np.sqrt(np.diagonal(ground_covariances(flat, self._side_m), axis1=1, axis2=2))
        yaws_deg = np.degrees(wrap_angle(-flat.headings_rad))
        return [
            dict(zip(GROUND_COLUMNS, (*place, yaw, *(std if std.any() else (None, None))), strict=True))
            for place, yaw, std in zip(positions.tolist(), yaws_deg.tolist(), stds, strict=True)
        ]


def _pose_rows(found: CameraPoses) -> list[dict[str, Any]]:
    """Return the values of `POSE_COLUMNS` and the covariance of each marker."""
    rows = []
    for k, (turn, shift, covariance) in enumerate(zip(*found[:3], strict=True)):
        alone = found.alone
        doubt = ["plane", None] if alone is None else ["alone", float(alone.log_ratios[k])]
        values = [*shift, *Rotation.from_matrix(turn).as_rotvec(), *np.sqrt(np.diag(covariance)), *doubt]
        row = dict(zip(POSE_COLUMNS, values, strict=True))
        row["pose_covariance"] = covariance
        if alone is not None:
            other = Rotation.from_matrix(alone.other_rotations[k]).as_rotvec()
            row["other_pose"] = np.concatenate([alone.other_translations_m[k], other])
        rows.append(row)
    return rows
