"""What was measured of the detectors' errors, and the biases that are subtracted from their results.

The tables are measured on rendered images: by `benchmarks/detector_accuracy.py` what is found, and errors, by
size of code, noise, blur and size; by `benchmarks/peer_biases.py` constant biases, at the noise and blur that
are named there.
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
"""Detectors whose errors were measured, and whose table has them: following markers changes the time taken,
not the errors."""

MIN_SIDE_PX = 1.0
"""Smallest side, px, that is left after a bias has been subtracted: `Detections` takes positive sides
only."""


@dataclass(frozen=True)
class DetectorAccuracy:
    """What one detector finds, and with what errors, at K marker sides; in between, linear in the side.

    Attributes:
        sides_px: (K,) true sides.
        recall: (K,) share of the markers that are found; none is below the first side.
        position_std_px: (K,) standard deviations of each of u and v.
        heading_std_rad: (K,) standard deviations of the heading.
        side_std: (K,) standard deviations of the side, as a share of it.
        squeeze_std: (K,) standard deviations of each of the two squeezes a and b of the marker's square,
            which take a point (x, y) about its centre to `(x + a x + b y, y + b x - a y)`.
    """

    sides_px: Array
    recall: Array
    position_std_px: Array
    heading_std_rad: Array
    side_std: Array
    squeeze_std: Array

    def covariances(self, sides_px: Array) -> Array:
        """Return covariances (N, 3, 3) of (u, v, heading) for markers of true sides (N,), px.

        They are diagonal, in px², px² and rad². Beyond the table its first and last rows hold.
        """
        covariances = np.zeros((sides_px.size, 3, 3))
        covariances[:, 0, 0] = np.interp(sides_px, self.sides_px, self.position_std_px) ** 2
        covariances[:, 1, 1] = covariances[:, 0, 0]
        covariances[:, 2, 2] = np.interp(sides_px, self.sides_px, self.heading_std_rad) ** 2
        return covariances

    def found(self, sides_px: Array, rng: np.random.Generator) -> BoolArray:
        """Draw which of N markers of true sides (N,), px, are found, each for itself."""
        return np.asarray(
            rng.random(sides_px.size) < np.interp(sides_px, self.sides_px, self.recall, left=0.0)
        )

    def draw_shapes(self, sides_px: Array, turns_rad: Array, rng: np.random.Generator) -> Array:
        """Draw errors of the size and shape of N squares of true sides (N,), px, that are turned as well.

        Args:
            sides_px: (N,) true sides.
            turns_rad: (N,) errors of their headings, from +u to +v.
            rng: draws.

        Returns:
            Matrices (N, 2, 2) that take the true corners about the centre to those measured: to first order
            the identity, the turn, and errors of the side and of both squeezes.
        """
        grow = np.interp(sides_px, self.sides_px, self.side_std) * rng.standard_normal(sides_px.size)
        squeeze = np.interp(sides_px, self.sides_px, self.squeeze_std)
        a, b = squeeze * rng.standard_normal((2, sides_px.size))
        return np.moveaxis(np.array([[1 + grow + a, b - turns_rad], [b + turns_rad, 1 + grow - a]]), -1, 0)


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


def load_accuracy(
    detector: str, *, dictionary: str = "4X4_50", noise: float = 2.0, psf_px: float = 0.8
) -> DetectorAccuracy:
    """Return what was measured of a detector, from `<detector>_accuracy.toml` in this package.

    The tables are of three sizes of code, several noises and several blurs, by the size of a cell. Of the
    codes the one nearest to the dictionary's is taken. Between the noises and blurs the values are linear;
    below the least ones theirs hold, which errs on the safe side.

    Args:
        detector: name of the detector.
        dictionary: of the markers.
        noise: standard deviation of the sensor's noise, grey levels.
        psf_px: standard deviation of the lens's blur.

    Raises:
        InputError: nothing was measured of that detector (`MEASURED_AS` has those of which something was), or
            not at so much noise or blur.
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
    """The grid (A, ...) at a value between the A places `at`, linear; the first one below them."""
    above = int(np.clip(np.searchsorted(at, value), 1, at.size - 1))
    share = float(np.clip((value - at[above - 1]) / (at[above] - at[above - 1]), 0.0, 1.0))
    return np.asarray((1 - share) * grid[above - 1] + share * grid[above])


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
