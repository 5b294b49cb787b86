"""Where markers may be: on the common plane, elsewhere than those that are known, and one at a place."""

from dataclasses import replace

import numpy as np

from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, to_complex
from skyherd.vision.photometric.fitting.fit_result import FitResults
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane

CORNER_SQUEEZE_ERROR_PX = 1.0
"""Accuracy of a squeeze that is computed from a quadrilateral's corners, px. Chosen: corners are found to
about a pixel. Within it, the plane's squeeze is the better start."""


def on_plane(homographies: LocalHomographies, plane: Plane, middle: complex) -> LocalHomographies:
    """Homographies with the plane's squeezes, where their own agree to the accuracy of corners."""
    squeezes = plane.squeezes(homographies.centers - middle) * homographies.arms.conj()
    near = np.abs(squeezes - homographies.squeezes) < CORNER_SQUEEZE_ERROR_PX
    return replace(homographies, squeezes=np.where(near, squeezes, homographies.squeezes))


def elsewhere(quads_px: Array, followed: LocalHomographies) -> BoolArray:
    """Which quadrilaterals (N, 4, 2) have their middle within no marker that is followed."""
    middles = to_complex(quads_px).mean(axis=1)
    distance = np.abs(middles[:, None] - followed.centers)
    return np.asarray((distance > followed.sides_px() / 2).all(axis=1))


def best_of_each_place(ids: IntArray, centers: ComplexArray, sides_px: Array, merits: Array) -> BoolArray:
    """Which of N (N,) stay if of those with one id in one place only that of the greatest merit does.

    Two share a place if their centres are less than half the shorter one's side apart, such as those of both
    boundaries of a marker's border.
    """
    reach_px = np.minimum(sides_px[:, None], sides_px) / 2
    twins = (np.abs(centers[:, None] - centers) < reach_px) & (ids[:, None] == ids)
    kept = np.ones(ids.size, dtype=bool)
    for row in np.argsort(-merits):
        if kept[row]:
            kept &= ~twins[:, row]
            kept[row] = True
    return kept


def unambiguous(fits: FitResults) -> FitResults:
    """The fits whose id was found once, in ascending order of id."""
    _, first, counts = np.unique(fits.ids, return_index=True, return_counts=True)
    return fits.take(first[counts == 1])
