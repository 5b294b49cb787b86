"""What was measured of the detectors' errors, and the biases that are subtracted from their results.

The tables are measured on rendered images, by `benchmarks/detector_accuracy.py` (errors by marker size) and
`benchmarks/peer_biases.py` (constant biases), at the noise and blur that are named in them.
"""

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array

MEASURED_AS = {"photometric": "photometric", "tracking": "photometric", "opencv": "opencv"}
"""Detectors whose errors were measured, and whose table has them: following markers changes the time taken,
not the errors."""

MIN_SIDE_PX = 1.0
"""Smallest side, px, that is left after a bias has been subtracted: `Detections` takes positive sides
only."""


@dataclass(frozen=True)
class DetectorAccuracy:
    """Measured errors of one detector at K marker sides; in between, linear in the side.

    Attributes:
        sides_px: (K,) true sides.
        position_std_px: (K,) standard deviations of each of u and v.
        heading_std_rad: (K,) standard deviations of the heading.
    """

    sides_px: Array
    position_std_px: Array
    heading_std_rad: Array

    def covariances(self, sides_px: Array) -> Array:
        """Return covariances (N, 3, 3) of (u, v, heading) for markers of true sides (N,), px.

        They are diagonal, in px², px² and rad². Beyond the table its first and last rows hold.
        """
        covariances = np.zeros((sides_px.size, 3, 3))
        covariances[:, 0, 0] = np.interp(sides_px, self.sides_px, self.position_std_px) ** 2
        covariances[:, 1, 1] = covariances[:, 0, 0]
        covariances[:, 2, 2] = np.interp(sides_px, self.sides_px, self.heading_std_rad) ** 2
        return covariances


@dataclass(frozen=True)
class ConstantBias:
    """Parts of a detector's error that are the same at every size.

    Attributes:
        position_px: mean error of u, and of v.
        side_px: mean of measured minus true side.
    """

    position_px: float
    side_px: float

    def true_sides_px(self, measured_px: Array) -> Array:
        """Return measured sides (N,), px, with the bias subtracted, `MIN_SIDE_PX` at least."""
        return np.maximum(measured_px - self.side_px, MIN_SIDE_PX)


def load_accuracy(detector: str) -> DetectorAccuracy:
    """Return the errors measured of a detector, from `<detector>_accuracy.toml` in this package.

    Raises:
        InputError: nothing was measured of that detector; `MEASURED_AS` has those of which something was.
    """
    if detector not in MEASURED_AS:
        what = f"nobody measured the noise of {detector!r}"
        raise InputError("detector", what, f"one of {', '.join(MEASURED_AS)}, or perception other than noisy")
    rows = _read_table(f"{MEASURED_AS[detector]}_accuracy.toml")["size"]

    def column(name: str) -> Array:
        return np.array([row[name] for row in rows], dtype=float)

    return DetectorAccuracy(
        sides_px=column("side_px"),
        position_std_px=column("position_std_px"),
        heading_std_rad=np.radians(column("heading_std_deg")),
    )


@cache
def load_bias(detector: str) -> ConstantBias:
    """Return the constant bias measured of a detector, from `peer_biases.toml` in this package.

    Raises:
        KeyError: nothing was measured of that detector.
    """
    row = _read_table("peer_biases.toml")[detector]
    return ConstantBias(position_px=row["position_bias_px"], side_px=row["side_bias_px"])


def _read_table(name: str) -> dict[str, Any]:
    return tomllib.loads(files("skyherd.vision.detectors").joinpath(name).read_text("utf-8"))
