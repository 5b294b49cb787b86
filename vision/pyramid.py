"""Markers of any size fitted at a size that serves: large ones in an image shrunk by a power of two.

A large marker has more pixels than are of use, and its pattern would have to be kept at as many. Shrunk by
means over k x k pixels, an image has the blur `σ'² = (σ² - 1/12) / k² + 1/12`: the lens's part shrinks, the
pixel's does not.
"""

from dataclasses import replace
from functools import reduce

import cv2
import numpy as np

from skyherd.geometry import IntArray
from skyherd.optics import PIXEL_VARIANCE
from skyherd.vision.fit import ROUNDS, fit_markers
from skyherd.vision.fits import Fits
from skyherd.vision.grey import Image
from skyherd.vision.plane import Plane
from skyherd.vision.shapes import Shapes

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
    octaves = np.maximum(np.ceil(np.log2(shapes.sides_px() / LARGEST_SIDE_PX)), 0).astype(int)
    if not octaves.any():
        return fit_markers(image, dictionary, ids, shapes, sigma_px, plane, noise, rounds)
    parts: list[Fits] = []
    for octave in np.unique(octaves):
        rows, shrink = np.flatnonzero(octaves == octave), 2 ** int(octave)
        variance = max((sigma_px**2 - PIXEL_VARIANCE) / shrink**2, 0.0) + PIXEL_VARIANCE
        near = shapes.take(rows).scaled(shrink)
        here = replace(plane, horizon=plane.horizon * shrink)
        small = _shrunk(image, shrink)
        fits, here = fit_markers(
            small, dictionary, ids[rows], near, variance**0.5, here, noise / shrink, rounds
        )
        scale = np.diag([shrink, shrink, 1.0])
        full_size = fits.shapes.scaled(1 / shrink)
        parts.append(
            replace(
                fits,
                shapes=full_size,
                covariances=scale @ fits.covariances @ scale,
                pixels=fits.pixels * shrink**2,
                moved_px=fits.moved_px * shrink,
            )
        )
        if len(parts) == 1:
            told = replace(here, horizon=here.horizon / shrink)
    return reduce(Fits.joined, parts), told


def _shrunk(image: Image, shrink: int) -> Image:
    """Means over squares of `shrink` pixels; lines that make no whole square are left out."""
    height, width = (side // shrink for side in image.shape)
    whole = image[: height * shrink, : width * shrink]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
