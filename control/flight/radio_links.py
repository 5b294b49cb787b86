"""Radio links in flight: a unit stays near the units through which its radio reaches the others.

A unit knows the image centres of other units in its own image, from shared robots. The distance between two
image centres is that of the units on the ground if their cameras look down.

A unit keeps its links in the minimum spanning tree of the places that it knows (as Li, Hou and Sha, INFOCOM
2003, for their neighbours). The units are connected at some range if no link of the tree is longer. Links
outside the tree may break.

Both ends keep a link of the whole team's tree, if they know each other's place, whatever others each knows: a
unit drops a link only if a path of shorter links joins its ends.
"""

from itertools import combinations

import numpy as np

from skyherd.geometry import Array, ComplexArray, IntArray

HOLD_SHARE = 0.85
"""Share of the radio range up to which a unit lets a link grow. Chosen: the rest covers tilts, and the flight
of both ends between two reports."""

TIE_SHARE = 0.05
"""A link is kept if a path of links shorter by at most this share joins its ends. Chosen: above the relative
error of a distance between image centres. Otherwise two units could each drop a link to a third one that they
expect the other to keep."""

ROUNDING = 1e-9
"""Tolerance of a constraint, m/s. Chosen: far below any flight speed, and above rounding errors."""


def kept_links(centers: ComplexArray) -> IntArray:
    """Return the rows of the other units that a unit at 0 must keep in range.

    Args:
        centers: (M,) places of the other units, in any unit of length.
    """
    places = np.concatenate([[0.0], centers])
    lengths = np.abs(places[:, None] - places)
    longest = lengths.copy()
    for via in range(places.size):
        # As Floyd and Warshall: the smallest longest link over all paths between two places.
        longest = np.minimum(longest, np.maximum(longest[:, via, None], longest[via]))
    return np.flatnonzero(longest[0, 1:] >= (1 - TIE_SHARE) * lengths[0, 1:])


def within_links(velocity_mps: Array, offsets: Array, hold: float, gain_mps: float) -> Array:
    """Return the velocity (2,), m/s, nearest to the wanted one that keeps all links.

    A unit may fly away from another one at `gain (hold - d) / 2` at most, with d their distance, and must
    approach it if that is negative. If both ends obey, `d' <= gain (hold - d)`, and d never exceeds `hold`.
    If no velocity keeps all links, the unit flies to the middle of the longest two.

    Args:
        velocity_mps: (2,) the wanted velocity.
        offsets: (K, 2) places of the other ends, relative to the unit.
        hold: maximum length of a link, in the unit of `offsets`.
        gain_mps: speed per unit of length.
    """
    lengths = np.linalg.norm(offsets, axis=1)
    apart = lengths > 0
    normals, lengths = offsets[apart] / lengths[apart, None], lengths[apart]
    least = -gain_mps * (hold - lengths) / 2
    candidates = [velocity_mps]
    candidates += [velocity_mps + (b - n @ velocity_mps) * n for n, b in zip(normals, least, strict=True)]
    for pair in combinations(range(len(normals)), 2):
        rows = list(pair)
        if abs(np.linalg.det(normals[rows])) > ROUNDING:
            candidates.append(np.linalg.solve(normals[rows], least[rows]))
    feasible = [v for v in candidates if (normals @ v >= least - ROUNDING).all()]
    if feasible:
        return np.asarray(min(feasible, key=lambda v: float(np.linalg.norm(v - velocity_mps))))
    longest = np.argsort(lengths)[-2:]
    return np.asarray(gain_mps * (normals * lengths[:, None])[longest].mean(axis=0))
