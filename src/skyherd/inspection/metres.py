"""Columns in metres of the table of detections, where the side of the markers is known."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from skyherd.control import Rectifier, rectified
from skyherd.geometry import wrap_angle
from skyherd.messages import Detections
from skyherd.poses import ground_covariances, ground_positions

GROUND_COLUMNS = ["x_m", "y_m", "yaw_deg", "std_x_m", "std_y_m"]
"""Columns of positions on the ground plane; standard deviations are empty where the detector states none."""


class MetricColumns:
    """Measurements in metres of the markers of one file, whose images are given in order.

    Args:
        side_m: side of the markers.
    """

    def __init__(self, side_m: float) -> None:
        self._side_m, self._rectifier = side_m, Rectifier()

    def rows(self, found: Detections) -> Sequence[dict[str, Any]]:
        """Return the values of the columns for each marker of the next image."""
        self._rectifier.rectify(found.unambiguous())
        flat = rectified(found, self._rectifier.ground_map)
        positions = ground_positions(flat, self._side_m)
        stds = np.sqrt(np.diagonal(ground_covariances(flat, self._side_m), axis1=1, axis2=2))
        yaws_deg = np.degrees(wrap_angle(-flat.headings_rad))
        return [
            dict(zip(GROUND_COLUMNS, (*place, yaw, *(std if std.any() else (None, None))), strict=True))
            for place, yaw, std in zip(positions.tolist(), yaws_deg.tolist(), stds, strict=True)
        ]
