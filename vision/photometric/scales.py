"""Markers of any size fitted at a size that serves: large ones in an image shrunk by a power of two.

A large marker has more pixels than are of use, and its pattern would have to be kept at as many. Shrunk by
means over k x k pixels, an image has the blur `σ'² = (σ² - 1/12) / k² + 1/12`: the lens's part shrinks, the
pixel's does not.
"""

import math
from dataclasses import replace
from functools import reduce

import cv2
import numpy as np

from skyherd.geometry import UNIFORM_VARIANCE, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.photometric.fit import ROUNDS, fit_markers
from skyherd.vision.photometric.fit_result import Fits
from skyherd.vision.photometric.local_homography import Shapes
from skyherd.vision.photometric.occlusion import fit_visible
from skyherd.vision.photometric.plane import Plane

LARGEST_SIDE_PX = 144.0
"""Larger markers are fitted in a shrunk image."""


def fit_all_sizes(
    image: Image,
    dictionary: str,
    ids: IntArray,
    shapes: Shapes,
    sigma_px: float,
    plane: Plane,
    noise: float,
    rounds: int = ROUNDS,
) -> tuple[Fits, Plane]:
    """As `fit_markers`, each marker at a resolution that suits it; the smallest tell the plane."""
    told = plane
    octaves = _octaves(shapes)
    if not octaves.any():
        return fit_markers(image, dictionary, ids, shapes, sigma_px, plane, noise, rounds)
    parts: list[Fits] = []
    for octave in np.unique(octaves):
        rows, level = octaves == octave, Level(image, 2 ** int(octave))
        fits, here = fit_markers(
            level.image,
            dictionary,
            ids[rows],
            shapes.take(rows).scaled(level.shrink),
            level.sigma_px(sigma_px),
            level.plane(plane),
            level.noise(noise),
            rounds,
        )
        parts.append(level.full_size(fits))
        if len(parts) == 1:
            told = replace(here, horizon=here.horizon / level.shrink)
    return reduce(Fits.joined, parts), told


def visible_all_sizes(
    image: Image, dictionary: str, fits: Fits, sigma_px: float, plane: Plane, noise: float
) -> Fits:
    """As `fit_visible`, each marker at a resolution that suits it, in the order of `fits`."""
    octaves, visible = _octaves(fits.shapes), fits
    for octave in np.unique(octaves):
        rows, level = np.flatnonzero(octaves == octave), Level(image, 2 ** int(octave))
        covered = fits.take(rows)
        seen = fit_visible(
            level.image,
            dictionary,
            replace(covered, shapes=covered.shapes.scaled(level.shrink)),
            level.sigma_px(sigma_px),
            level.plane(plane),
            level.noise(noise),
        )
        visible = visible.put(rows, level.full_size(seen))
    return visible


def _octaves(shapes: Shapes) -> IntArray:
    """(N,) how often the image is to be halved for each marker."""
    octaves = np.maximum(np.ceil(np.log2(shapes.sides_px() / LARGEST_SIDE_PX)), 0)
    return np.asarray(octaves, dtype=np.int64)


class Level:
    """An image shrunk by means over `shrink` x `shrink` pixels, and what is known of it at that size."""

    def __init__(self, image: Image, shrink: int) -> None:
        self.shrink = shrink
        self.image = image if shrink == 1 else _shrunk(image, shrink)

    def sigma_px(self, sigma_px: float) -> float:
        """Blur of lens and pixel, small pixels."""
        return math.sqrt(max((sigma_px**2 - UNIFORM_VARIANCE) / self.shrink**2, 0.0) + UNIFORM_VARIANCE)

    def noise(self, noise: float) -> float:
        """Standard deviation of a small pixel, grey levels: a mean's, rounded once more."""
        return noise if self.shrink == 1 else math.hypot(noise / self.shrink, UNIFORM_VARIANCE**0.5)

    def plane(self, plane: Plane) -> Plane:
        """The plane in small pixels."""
        return replace(plane, horizon=plane.horizon * self.shrink)

    def full_size(self, fits: Fits) -> Fits:
        """Fits in this image as of the full-size one."""
        scale = np.diag([self.shrink, self.shrink, 1.0])
        return replace(
            fits,
            shapes=fits.shapes.scaled(1 / self.shrink),
            covariances=scale @ fits.covariances @ scale,
            pixels=fits.pixels * self.shrink**2,
            moved_px=fits.moved_px * self.shrink,
        )


def _shrunk(image: Image, shrink: int) -> Image:
    """Means over squares of `shrink` pixels; lines that make no whole square are left out."""
    height, width = (side // shrink for side in image.shape)
    whole = image[: height * shrink, : width * shrink]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
