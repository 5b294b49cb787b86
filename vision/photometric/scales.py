"""Markers of any size, each fitted at a resolution that suits it: large ones in a shrunk image.

A large marker has more pixels than are of use, and each costs time and memory. Shrunk by means over k x k
pixels, an image has a blur of variance `σ'² = (σ² - 1/12) / k² + 1/12`, px²: the lens's part shrinks, that of
the square pixel, 1/12, does not.
"""

import math
from dataclasses import replace
from functools import reduce

import numpy as np

from skyherd.geometry import UNIFORM_VARIANCE, Array, IntArray
from skyherd.vision.grey import Image, block_means
from skyherd.vision.photometric.fitting.fit import MAX_STEPS, fit_markers
from skyherd.vision.photometric.fitting.fit_result import FitResults
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.occlusion import fit_visible
from skyherd.vision.photometric.fitting.plane import Plane

MAX_SIDE_PX = 144.0
"""Side, px, above which a marker is fitted in an image shrunk by 2, 4, 8 and so on, so that its side there is
between 72 and 144 px. Chosen: a smaller value makes large markers less precise, a larger one costs time and
memory with its square."""


def fit_all_sizes(
    image: Image,
    dictionary: str,
    ids: IntArray,
    homographies: LocalHomographies,
    sigma_px: float | Array,
    plane: Plane,
    noise: float,
    max_steps: int = MAX_STEPS,
    *,
    alone: bool = False,
    max_side_px: float = MAX_SIDE_PX,
    streak_px2: complex | None = None,
) -> tuple[FitResults, Plane]:
    """Do as `fit_markers`, with each marker at a resolution that suits it.

    Arguments and results are those of `fit_markers` and refer to the full-size image; the plane is that of
    the smallest markers. Markers of more than `max_side_px` are fitted in a shrunk image.
    """
    sigmas_px = np.broadcast_to(np.asarray(sigma_px, dtype=float), (ids.size,))
    octaves = _octaves(homographies, max_side_px)
    if not octaves.any():
        given = image, dictionary, ids, homographies, sigma_px, plane, noise, max_steps
        return fit_markers(*given, alone=alone, streak_px2=streak_px2)
    parts: list[FitResults] = []
    order: list[IntArray] = []
    fitted_plane = plane
    for octave in np.unique(octaves):
        rows, scaled = np.flatnonzero(octaves == octave), ScaledImage(image, 2 ** int(octave))
        order.append(rows)
        fits, here = fit_markers(
            scaled.image,
            dictionary,
            ids[rows],
            homographies.take(rows).scaled(scaled.shrink),
            scaled.sigmas_px(sigmas_px[rows]),
            scaled.plane(plane),
            scaled.noise(noise),
            max_steps,
            alone=alone,
            streak_px2=None if streak_px2 is None else streak_px2 / scaled.shrink**2,
        )
        parts.append(scaled.full_size(fits))
        if len(parts) == 1:
            fitted_plane = replace(here, horizon=here.horizon / scaled.shrink)
    return reduce(FitResults.joined, parts).take(np.argsort(np.concatenate(order))), fitted_plane


def fit_visible_all_sizes(
    image: Image, dictionary: str, fits: FitResults, sigma_px: float | Array, plane: Plane, noise: float
) -> FitResults:
    """Do as `fit_visible`, with each marker at a resolution that suits it; in the order of `fits`."""
    octaves, visible = _octaves(fits.homographies, MAX_SIDE_PX), fits
    sigmas_px = np.broadcast_to(np.asarray(sigma_px, dtype=float), (fits.ids.size,))
    for octave in np.unique(octaves):
        rows, scaled = np.flatnonzero(octaves == octave), ScaledImage(image, 2 ** int(octave))
        covered = fits.take(rows)
        refitted = fit_visible(
            scaled.image,
            dictionary,
            replace(covered, homographies=covered.homographies.scaled(scaled.shrink)),
            scaled.sigmas_px(sigmas_px[rows]),
            scaled.plane(plane),
            scaled.noise(noise),
        )
        visible = visible.put(rows, scaled.full_size(refitted))
    return visible


def _octaves(homographies: LocalHomographies, max_side_px: float) -> IntArray:
    """How often (N,) the image is to be halved for each marker."""
    octaves = np.maximum(np.ceil(np.log2(homographies.sides_px() / max_side_px)), 0)
    return np.asarray(octaves, dtype=np.int64)


class ScaledImage:
    """An image shrunk by means over `shrink` x `shrink` pixels, and what is known of it at that size.

    Lines and columns that make no whole square are left out. With `shrink` 1 the image is used as it is.
    """

    def __init__(self, image: Image, shrink: int) -> None:
        self.shrink = shrink
        self.image = image if shrink == 1 else block_means(image, shrink)

    def sigmas_px(self, sigmas_px: Array) -> Array:
        """Return blurs (N,) of lens and pixel in shrunk pixels, from those in full-size pixels."""
        return _with_pixel(np.maximum(sigmas_px**2 - UNIFORM_VARIANCE, 0.0) / self.shrink**2)

    def full_size_sigmas_px(self, sigmas_px: Array) -> Array:
        """Return blurs (N,) of lens and pixel in full-size pixels, from those in shrunk pixels."""
        return _with_pixel(np.maximum(sigmas_px**2 - UNIFORM_VARIANCE, 0.0) * self.shrink**2)

    def noise(self, noise: float) -> float:
        """Return the standard deviation of a shrunk pixel, grey levels: that of a mean, rounded once more."""
        return noise if self.shrink == 1 else math.hypot(noise / self.shrink, UNIFORM_VARIANCE**0.5)

    def plane(self, plane: Plane) -> Plane:
        """Return the plane in shrunk pixels: its horizon is a reciprocal length."""
        return replace(plane, horizon=plane.horizon * self.shrink)

    def full_size(self, fits: FitResults) -> FitResults:
        """Return results of fits in the shrunk image in pixels of the full-size one."""
        scale = np.diag([self.shrink, self.shrink, 1.0])
        return replace(
            fits,
            homographies=fits.homographies.scaled(1 / self.shrink),
            covariances=scale @ fits.covariances @ scale,
            sigmas_px=self.full_size_sigmas_px(fits.sigmas_px),
            pixels=fits.pixels * self.shrink**2,
            moved_px=fits.moved_px * self.shrink,
        )


def _with_pixel(variances: Array) -> Array:
    """Standard deviations (N,) of lenses of given variances, px², and a square pixel together."""
    return np.asarray(np.sqrt(variances + UNIFORM_VARIANCE))
