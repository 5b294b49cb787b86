"""Which quadrilaterals of an image share a place: of such candidates, one at most is a marker."""

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray


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


def first_of_each_place(quads_px: Array) -> IntArray:
    """Return the rows of the quadrilaterals (N, 4, 2) that share no place with an earlier one that is kept.

    Two share a place if one contains the mean of the other's corners.
    """
    middles_px = quads_px.mean(axis=1)
    kept = np.zeros(len(quads_px), dtype=np.int64)
    count = 0
    for row in range(len(quads_px)):
        earlier = kept[:count]
        if not (
            contain(quads_px[earlier], middles_px[row]).any()
            or contain(quads_px[row], middles_px[earlier]).any()
        ):
            kept[count] = row
            count += 1
    return kept[:count]
