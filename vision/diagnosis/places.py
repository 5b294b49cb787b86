"""Which quadrilaterals of an image share a place: of such candidates, one at most is a marker."""

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.dictionary import card_side
from skyherd.messages import Detections

REACH = 0.6
"""A candidate centred within this share of a detected card's side from its centre is part of that card.
Chosen: more than half, for candidates that reach over its edge."""

QUADS_AT_ONCE = 256
"""Quadrilaterals that are compared with all others at once. Chosen: bounds the memory."""


def contain(quads_px: Array, points_px: Array) -> BoolArray:
    """Return whether quadrilaterals (..., 4, 2) contain points (..., 2), by the even-odd rule; broadcast."""
    u, v = points_px[..., None, 0], points_px[..., None, 1]
    ends = np.roll(quads_px, -1, axis=-2)
    du, dv = np.moveaxis(ends - quads_px, -1, 0)
    crosses = (quads_px[..., 1] > v) != (ends[..., 1] > v)
    share = np.divide(v - quads_px[..., 1], dv, out=np.zeros(crosses.shape), where=crosses)
    beyond = crosses & (u < quads_px[..., 0] + share * du)
    return np.asarray(beyond.sum(axis=-1) % 2 == 1)


def lie_on_markers(quads_px: Array, centers_px: Array, reaches_px: Array) -> BoolArray:
    """Return which quadrilaterals (N, 4, 2) are, lie on, or surround one of M markers.

    Args:
        quads_px: corners, in order around each.
        centers_px: (M, 2) centres of the markers.
        reaches_px: (M,) distances from its centre within which a marker covers centres of quadrilaterals.
    """
    on = np.zeros(len(quads_px), dtype=bool)
    middles_px = quads_px.mean(axis=1)
    for center_px, reach_px in zip(centers_px, reaches_px, strict=True):
        on |= (np.linalg.norm(middles_px - center_px, axis=1) < reach_px) | contain(quads_px, center_px)
    return on


def on_detections(quads_px: Array, detections: Detections, dictionary: str) -> BoolArray:
    """Return which quadrilaterals (N, 4, 2) are part of a detected marker's card, or surround one."""
    reaches_px = REACH * card_side(dictionary) * detections.sides_px
    return lie_on_markers(quads_px, detections.centers_px, reaches_px)


def first_of_each_place(quads_px: Array) -> IntArray:
    """Return the rows of the quadrilaterals (N, 4, 2) that share no place with an earlier one that is kept.

    Two share a place if one contains the mean of the other's corners.
    """
    one, other = _sharing(quads_px)
    order = np.argsort(one, kind="stable")
    one, other = one[order], other[order]
    kept = np.ones(len(quads_px), dtype=bool)
    rows, begins = np.unique(one, return_index=True)
    for row, later in zip(rows.tolist(), np.split(other, begins)[1:], strict=True):
        if kept[row]:
            kept[later] = False
    return np.flatnonzero(kept)


def _sharing(quads_px: Array) -> tuple[IntArray, IntArray]:
    """Return all pairs of quadrilaterals (N, 4, 2) that share a place: the earlier row (P,) and the later."""
    middles_px, low_px, high_px = quads_px.mean(axis=1), quads_px.min(axis=1), quads_px.max(axis=1)
    pairs = [np.zeros((2, 0), dtype=np.int64)]
    for first in range(0, len(quads_px), QUADS_AT_ONCE):
        part = slice(first, first + QUADS_AT_ONCE)
        in_box = np.ones((len(middles_px[part]), len(middles_px)), dtype=bool)
        for low, high, middle in zip(low_px[part].T, high_px[part].T, middles_px.T, strict=True):
            in_box &= (low[:, None] <= middle) & (middle <= high[:, None])
        around, inside = np.nonzero(in_box)
        around += first
        apart = around != inside
        around, inside = around[apart], inside[apart]
        contains = contain(quads_px[around], middles_px[inside])
        pairs.append(np.stack([around[contains], inside[contains]]))
    both = np.concatenate(pairs, axis=1)
    return both.min(axis=0), both.max(axis=0)
