"""Measured recall and errors of the detectors, and the constant biases to subtract from their results.

All tables are measured on rendered images. `benchmarks/detector_accuracy.py` measures recall and errors by
code size, noise, blur and marker side. `benchmarks/peer_biases.py` measures constant biases at noise 2 and
blur 0.8 px, averaged over marker sides.
"""

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array, BoolArray
from skyherd.markers.dictionary import cells_per_side

MEASURED_AS = {"photometric": "photometric", "tracking": "photometric", "opencv": "opencv"}
"""Measured detectors, and the detector whose table applies: following markers changes the time, not the
errors."""

MIN_SIDE_PX = 1.0
"""Smallest side after subtraction of a bias, px. Chosen: `Detections` accepts positive sides only."""


@dataclass(frozen=True)
class DetectorAccuracy:
    """Recall and error standard deviations of one detector at K marker sides, interpolated linearly.

    Attributes:
        sides_px: (K,) true sides.
        recall: (K,) share of the markers that are detected; 0 below the first side.
        position_std_px: (K,) standard deviation of u and of v.
        heading_std_rad: (K,) standard deviation of the heading.
        side_std: (K,) relative standard deviation of the side.
        squeeze_std: (K,) standard deviation of each anisotropy component a and b of the marker's square. They
            map a point (x, y) relative to the centre to `(x + a x + b y, y + b x - a y)`.
    """

    sides_px: Array
    recall: Array
    position_std_px: Array
    heading_std_rad: Array
    side_std: Array
    squeeze_std: Array

    def covariances(self, sides_px: Array) -> Array:
        """Return covariances (N, 3, 3) of (u, v, heading) for markers of true sides (N,), px.

        They are diagonal, in px², px² and rad². Outside the table, the first or last row applies.
        """
        covariances = np.zeros((sides_px.size, 3, 3))
        covariances[:, 0, 0] = np.interp(sides_px, self.sides_px, self.position_std_px) ** 2
        covariances[:, 1, 1] = covariances[:, 0, 0]
        covariances[:, 2, 2] = np.interp(sides_px, self.sides_px, self.heading_std_rad) ** 2
        return covariances

    def found(self, sides_px: Array, rng: np.random.Generator) -> BoolArray:
        """Draw a mask (N,) of the detected markers, independently, for true sides (N,), px."""
        return np.asarray(
            rng.random(sides_px.size) < np.interp(sides_px, self.sides_px, self.recall, left=0.0)
        )

    def draw_shapes(self, sides_px: Array, turns_rad: Array, rng: np.random.Generator) -> Array:
        """Draw errors of side and anisotropy for N squares, and combine them with given heading errors.

        Args:
            sides_px: (N,) true sides.
            turns_rad: (N,) heading errors, from +u to +v.
            rng: random number generator.

        Returns:
            Matrices (N, 2, 2) that map the true corners relative to the centre to the measured ones. To first
            order they are the identity plus the rotation, the side error and both anisotropy components.
        """
        grow = np.interp(sides_px, self.sides_px, self.side_std) * rng.standard_normal(sides_px.size)
        squeeze = np.interp(sides_px, self.sides_px, self.squeeze_std)
        a, b = squeeze * rng.standard_normal((2, sides_px.size))
        return np.moveaxis(np.array([[1 + grow + a, b - turns_rad], [b + turns_rad, 1 + grow - a]]), -1, 0)


@dataclass(frozen=True)
class ConstantBias:
    """Bias of a detector that does not depend on the marker's side.

    Attributes:
        position_px: mean error of u and of v.
        side_px: mean of the measured minus the true side.
    """

    position_px: float
    side_px: float

    def true_sides_px(self, measured_px: Array) -> Array:
        """Return measured sides (N,), px, minus the bias, and at least `MIN_SIDE_PX`."""
        return np.maximum(measured_px - self.side_px, MIN_SIDE_PX)


def load_accuracy(
    detector: str, *, dictionary: str = "4X4_50", noise: float = 2.0, psf_px: float = 0.8
) -> DetectorAccuracy:
    """Return the measured accuracy of a detector, from `<detector>_accuracy.toml` in this package.

    The tables have three code sizes, several noises and several blurs, by cell size. The code size nearest to
    the dictionary's applies. Values are interpolated linearly in noise and blur. Below the smallest measured
    noise or blur, its values apply, which overestimates the errors.

    Args:
        detector: name of the detector.
        dictionary: name of the marker dictionary.
        noise: standard deviation of the sensor noise, grey levels.
        psf_px: standard deviation of the lens blur.

    Raises:
        InputError: the detector is not in `MEASURED_AS`, or the noise or blur exceeds the measured range.
    """
    if detector not in MEASURED_AS:
        what = f"nobody measured the noise of {detector!r}"
        raise InputError("detector", what, f"one of {', '.join(MEASURED_AS)}, or perception other than noisy")
    table = _read_table(f"{MEASURED_AS[detector]}_accuracy.toml")
    noises, blurs = np.array(table["noise"]), np.array(table["psf_px"])
    for name, value, most in (("noise", noise, noises[-1]), ("psf_px", psf_px, blurs[-1])):
        if value > most:
            what = f"{detector} was not measured at {value:g}"
            raise InputError(f"sensor.{name}", what, f"{most:g} at most, or perception other than noisy")
    cells = cells_per_side(dictionary)
    code = min(table["codes"], key=lambda code: (abs(code["cells"] - cells), code["cells"]))

    def column(name: str) -> Array:
        grid = np.array(code[name], dtype=float)  # (noises, blurs, sizes of a cell)
        return _between(_between(grid, noises, noise), blurs, psf_px)

    return DetectorAccuracy(
        sides_px=cells * np.array(table["cell_px"]),
        recall=column("recall"),
        position_std_px=column("position_std_px"),
        heading_std_rad=np.radians(column("heading_std_deg")),
        side_std=column("side_std"),
        squeeze_std=column("squeeze_std"),
    )


def _between(grid: Array, at: Array, value: float) -> Array:
    """Return the grid (A, ...), interpolated linearly between the A nodes `at` and clamped to them."""
    above = int(np.clip(np.searchsorted(at, value), 1, at.size - 1))
    share = float(np.clip((value - at[above - 1]) / (at[above] - at[above - 1]), 0.0, 1.0))
    return np.asarray((1 - share) * grid[above - 1] + share * grid[above])


@cache
def load_bias(detector: str) -> ConstantBias:
    """Return the measured constant bias of a detector, from `peer_biases.toml` in this package.

    Raises:
        KeyError: the table has no such detector.
    """
    row = _read_table("peer_biases.toml")[detector]
    return ConstantBias(position_px=row["position_bias_px"], side_px=row["side_bias_px"])


def _read_table(name: str) -> dict[str, Any]:
    return tomllib.loads(files("skyherd.vision.detectors").joinpath(name).read_text("utf-8"))
