"""What was measured of a detector, by marker size: its errors, and the biases to take off.

The tables are measured by `benchmarks/detector_accuracy.py` on rendered images at the noise and blur
named in them.
"""

import tomllib
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from skyherd.geometry import Array

MEASURED_AS = {"tracking": "photometric"}
"""Detectors whose errors are those of another: following markers changes time, not error."""


@dataclass(frozen=True)
class DetectorAccuracy:
    """Measured errors of one detector at marker sides (K,), px; between them, linear in the side.

    Attributes:
        sides_px: (K,) true sides.
        side_bias_px: (K,) mean of measured minus true side.
        position_std_px: (K,) standard deviation of each of u and v.
        heading_std_rad: (K,) standard deviation of the heading.
    """

    sides_px: Array
    side_bias_px: Array
    position_std_px: Array
    heading_std_rad: Array

    def true_sides_px(self, measured_px: Array) -> Array:
        """Sides with the mean error taken off."""
        return measured_px - np.interp(measured_px, self.sides_px + self.side_bias_px, self.side_bias_px)

    def covariances(self, sides_px: Array) -> Array:
        """(N, 3, 3) covariance of (u, v, heading) for markers of (N,) true sides."""
        covariances = np.zeros((sides_px.size, 3, 3))
        covariances[:, 0, 0] = np.interp(sides_px, self.sides_px, self.position_std_px) ** 2
        covariances[:, 1, 1] = covariances[:, 0, 0]
        covariances[:, 2, 2] = np.interp(sides_px, self.sides_px, self.heading_std_rad) ** 2
        return covariances


def load_accuracy(detector: str) -> DetectorAccuracy:
    """Read the table `<detector>_accuracy.toml` that is shipped with the package."""
    measured = MEASURED_AS.get(detector, detector)
    table = tomllib.loads(
        files("skyherd.vision.detectors").joinpath(f"{measured}_accuracy.toml").read_text("utf-8")
    )
    rows = table["size"]

    def column(name: str) -> Array:
        return np.array([row[name] for row in rows], dtype=float)

    return DetectorAccuracy(
        sides_px=column("side_px"),
        side_bias_px=column("side_bias_px"),
        position_std_px=column("position_std_px"),
        heading_std_rad=np.radians(column("heading_std_deg")),
    )
