"""What a marker looks like under blur, and how that changes with pose and blur: the templates of the fit.

In marker coordinates z = right + i down, of unit side and with black as 0 and white as 1, a marker on endless
white, seen under a Gaussian of standard deviation σ, separates (`skyherd.markers.blur_model`):

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

BLUR_STEP = 1.05
"""Patterns are kept for blurs, in sides, in this geometric progression; the fit takes up the rest."""

SAMPLES_PER_SIGMA = 3.0
"""Bilinear reading adds `f (1 - f) h² T'' / 2`, which is `h² T'' / 12` on average and is taken off
beforehand. What is left is `h² T'' / 12 = 0.11 x 0.24 / 12` of the contrast at most along an edge: 0.45 of
200 levels; at corners up to twice that, and a quarter of it in the root mean square."""

MAX_SAMPLES = 640
"""Patterns of large markers are sampled less finely, so that each takes 6.5 MB at most."""

REACH_SIGMAS = 4.0


@dataclass(frozen=True)
class Pattern:
    """T, T_x, T_y, T_log σ of one marker, (S, S, 4) float32, at samples `rate z + center`."""

    values: npt.NDArray[np.float32]
    rate: float
    center: float


def _pattern(values: Array, rate: float) -> Pattern:
    """A pattern of `rate` samples to a marker side, the marker's centre in its middle."""
    kept = np.ascontiguousarray(values, dtype=np.float32)
    kept.setflags(write=False)
    return Pattern(kept, rate, (len(kept) - 1) / 2)


def blur_buckets(relative_sigmas: Array) -> IntArray:
    """Indices (N,) of the patterns nearest to blurs (N,), in marker sides."""
    return np.rint(np.log(relative_sigmas) / math.log(BLUR_STEP)).astype(np.int64)


def _axis(extent: float, sigma: float) -> tuple[Array, float]:
    """Samples from -extent to extent or a little further, and how many there are to a side."""
    half = int(np.ceil(extent * SAMPLES_PER_SIGMA / sigma))
    rate = min(half, MAX_SAMPLES // 2) / extent
    half = min(half, MAX_SAMPLES // 2)
    return np.arange(-half, half + 1) / rate, rate


@lru_cache(maxsize=256)
def make_pattern(dictionary: str, marker_id: int, bucket: int) -> Pattern:
    """Pattern of a marker at a blur of `BLUR_STEP ** bucket` marker sides."""
    sigma = BLUR_STEP**bucket
    x, rate = _axis(0.5 + REACH_SIGMAS * sigma, sigma)
    product, e = _products(dictionary, marker_id, x, sigma)
    curvature = sigma**2 * e.curvature
    bend = product(e.value, curvature) + product(curvature, e.value)
    channels = [
        1.0 + product(e.value, e.value) - bend / (12 * (sigma * rate) ** 2),
        product(e.value, e.slope),
        product(e.slope, e.value),
        bend,
    ]
    return _pattern(np.stack(channels, axis=-1), rate)


def _products(
    dictionary: str, marker_id: int, x: Array, sigma: float
) -> tuple[Callable[[Array, Array], Array], Gathered]:
    """The map `- down B rightᵀ` of a marker's black cells B, and E with its derivatives at x (S,)."""
    black = (~marker_cells(dictionary, marker_id)).astype(float)
    e = gather_with_derivatives(x, np.arange(len(black) + 1) / len(black) - 0.5, sigma)

    def product(down: Array, right: Array) -> Array:
        # OpenCV's product, not NumPy's: BLAS threads on so small a product cost more than it does.
        return np.asarray(cv2.gemm(down @ black, right, -1.0, np.empty(0), 0.0, flags=cv2.GEMM_2_T))

    return product, e


@lru_cache(maxsize=256)
def make_bend(dictionary: str, marker_id: int, bucket: int) -> Pattern:
    """What a blur that is round in the image does where the marker is squeezed: (S, S, 2) float32.

    A squeeze z ↦ z + e z̄ leaves in marker coordinates a blur of variances σ² (1 ∓ 2 e_x) and covariance
    -2 σ² e_y, to first order, and so changes T by `- e_x σ² (T_xx - T_yy) - 2 e_y σ² T_xy`: the two factors
    of -e.
    """
    sigma = BLUR_STEP**bucket
    x, rate = _axis(0.5 + REACH_SIGMAS * sigma, sigma)
    product, e = _products(dictionary, marker_id, x, sigma)
    curvature = sigma**2 * e.curvature
    along = product(e.value, curvature) - product(curvature, e.value)
    return _pattern(np.stack([along, 2 * sigma**2 * product(e.slope, e.slope)], axis=-1), rate)
