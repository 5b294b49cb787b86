"""What a marker looks like under blur, and how that changes with pose and blur: the templates of the fit.

In marker coordinates z = right + i down, in sides, with black as 0 and white as 1, a marker on an endless
white ground seen under a Gaussian of standard deviation σ separates (`skyherd.markers.blur_model`):

    T(y, x) = 1 - Σ_r Σ_c E_r(y) B_rc E_c(x),   B_rc = 1 where the cell is black,

and so do its derivatives T_x, T_y and, by the heat equation, `T_log σ = σ² (T_xx + T_yy)`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, IntArray
from skyherd.markers.blur_model import Gathered, gather_with_derivatives
from skyherd.markers.dictionary import marker_cells
from skyherd.vision.photometric.pixel_support import Floats

BLUR_STEP = 1.05
"""Patterns are kept for blurs, in sides, in this geometric progression; the fit's unknown `BLUR` takes up the
rest, 2.5 % at most. Chosen: a smaller step means more patterns in memory, a larger one more error of second
order."""

SAMPLES_PER_SIGMA = 3.0
"""Samples of a pattern to one standard deviation of its blur. Derived: bilinear reading at a fraction f
between samples h apart adds `f (1 - f) h² T'' / 2`, which is `h² T'' / 12` on average and is subtracted
beforehand. The rest is `h² T'' / 12 = 0.11 x 0.24 / 12` of the contrast at most along an edge, 0.45 of 200
grey levels; at corners up to twice that; and a quarter of it in the root mean square. Both h² and the error
fall by four at twice the value."""

MAX_SAMPLES = 640
"""Most samples of a pattern along each side; patterns of large, sharp markers are sampled less finely.
Derived from memory: 640² samples of four channels of 4 bytes are 6.5 MB."""

REACH_SIGMAS = 4.0
"""How far a pattern reaches beyond the black square, standard deviations of the blur. Chosen: beyond it T is
1 to within 3e-5, as the pattern's outermost samples, which are repeated, say."""


@dataclass(frozen=True)
class Pattern:
    """Sampled functions of marker coordinates, for one marker at one blur.

    Attributes:
        values: (S, S, channels) float32, read-only. Sample (row, column) is at the marker coordinates (x, y)
            with `column = rate x + center` and `row = rate y + center`.
        rate: samples to a marker side.
        center: index of the marker's centre along both axes.
    """

    values: npt.NDArray[np.float32]
    rate: float
    center: float


def _pattern(channels: list[Floats], rate: float) -> Pattern:
    """A pattern of `rate` samples to a marker side, the marker's centre in its middle."""
    kept = np.asarray(cv2.merge(channels), dtype=np.float32)
    kept.setflags(write=False)
    return Pattern(kept, rate, (len(kept) - 1) / 2)


def blur_buckets(relative_sigmas: Array) -> IntArray:
    """Return the buckets (N,) with `BLUR_STEP ** bucket` nearest to blurs (N,), in marker sides."""
    return np.rint(np.log(relative_sigmas) / math.log(BLUR_STEP)).astype(np.int64)


def _axis(extent: float, sigma: float) -> tuple[Array, float]:
    """Samples from -extent to extent or a little further, and how many there are to a side."""
    half = int(np.ceil(extent * SAMPLES_PER_SIGMA / sigma))
    rate = min(half, MAX_SAMPLES // 2) / extent
    half = min(half, MAX_SAMPLES // 2)
    return np.arange(-half, half + 1) / rate, rate


@lru_cache(maxsize=256)
def make_pattern(dictionary: str, marker_id: int, bucket: int) -> Pattern:
    """Return T, T_x, T_y and T_log σ of a marker, (S, S, 4), at a blur of `BLUR_STEP ** bucket` marker sides.

    Results are kept, the last 256 of them.

    Raises:
        InputError: there is no such dictionary, or no marker of that id in it.
    """
    sigma = BLUR_STEP**bucket
    x, rate = _axis(0.5 + REACH_SIGMAS * sigma, sigma)
    product, e = _products(dictionary, marker_id, x, sigma)
    curvature = sigma**2 * e.curvature
    log_blur = product(e.value, curvature) + product(curvature, e.value)
    channels = [
        1 + product(e.value, e.value) - log_blur / np.float32(12 * (sigma * rate) ** 2),
        product(e.value, e.slope),
        product(e.slope, e.value),
        log_blur,
    ]
    return _pattern(channels, rate)


def _products(
    dictionary: str, marker_id: int, x: Array, sigma: float
) -> tuple[Callable[[Array, Array], Floats], Gathered]:
    """The map `- down B rightᵀ` of a marker's black cells B, and E with its derivatives at x (S,).

    Products are in single precision, as patterns are kept, which is six times as fast as double.
    """
    black = (~marker_cells(dictionary, marker_id)).astype(float)
    e = gather_with_derivatives(x, np.arange(len(black) + 1) / len(black) - 0.5, sigma)

    def product(down: Array, right: Array) -> Floats:
        # OpenCV's product, not NumPy's: BLAS threads on so small a product cost more than it does.
        rows, columns = (down @ black).astype(np.float32), right.astype(np.float32)
        none = np.empty(0, dtype=np.float32)
        return np.asarray(cv2.gemm(rows, columns, -1.0, none, 0.0, flags=cv2.GEMM_2_T), dtype=np.float32)

    return product, e


@lru_cache(maxsize=256)
def make_anisotropy(dictionary: str, marker_id: int, bucket: int) -> Pattern:
    """Return how T changes where a marker is squeezed, (S, S, 2), at a blur of `BLUR_STEP ** bucket` sides.

    Blur that is round in the image is not round in the coordinates of a squeezed marker. A squeeze
    z ↦ z + e z̄ leaves there a blur of variances σ² (1 ∓ 2 e_x) and covariance -2 σ² e_y, to first order, and
    so changes T by `- e_x σ² (T_xx - T_yy) - 2 e_y σ² T_xy`: the two channels are the factors of -e_x and
    -e_y. Results are kept, the last 256 of them.

    Raises:
        InputError: there is no such dictionary, or no marker of that id in it.
    """
    sigma = BLUR_STEP**bucket
    x, rate = _axis(0.5 + REACH_SIGMAS * sigma, sigma)
    product, e = _products(dictionary, marker_id, x, sigma)
    curvature = sigma**2 * e.curvature
    along = product(e.value, curvature) - product(curvature, e.value)
    return _pattern([along, np.float32(2 * sigma**2) * product(e.slope, e.slope)], rate)
