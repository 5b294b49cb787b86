"""Markers that all moved by one motion that was not expected, as when the camera begins to climb or stops.

Markers are predicted from their own last steps (`skyherd.vision.photometric.tracks`). When the camera's
velocity changes, all of them lie elsewhere, the more so the farther from the image's middle they are, and
fits that begin half a side away find nothing. But they moved alike: whatever moved the camera over flat
ground takes every point p of the image to about `a p + b`. A few markers tell that motion, and all others are
then fitted where it takes them. What is missing then, such as a robot that began to turn, is searched for
about its place, before the whole image is.
"""

import math
from dataclasses import replace

import numpy as np

from skyherd.geometry import SQUARE_CORNERS, Array
from skyherd.vision.grey import Image
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.search.quads import find_quads

MAX_SHARE = 0.5
"""Share of an image up to which it is searched by parts. Chosen: parts overlap, and each costs something."""

NEAR_MARKERS = 4
"""Markers about whose places an image is searched when none is where it was predicted. Chosen: one tells the
motion, and some may be hidden or go ways of their own; each takes about a millisecond."""

REACH_SIDES = 3.0
"""How far from its predicted place a marker is searched for, in its sides. Chosen: a camera that starts to
climb at 1 m/s over 10 m moves markers in the corner of an image by half a side within 0.2 s, and those near
its middle less; the time grows with the square."""

MIN_MARKERS = 3
"""Markers that tell a rotation at least. Chosen: two robots side by side that drive apart look like one."""

MIN_SHIFT_SIDES = 0.02
"""Markers are fitted again only if the motion moves them by more than this, in their sides. Chosen: fits find
a marker that lies a tenth of a side off, so that one that was missed for less is missed for another
reason."""


def common_motion(before: LocalHomographies, after: LocalHomographies) -> tuple[complex, complex]:
    """Return the similarity (a, b), `p -> a p + b`, that takes markers (N,), at least one, to where they are.

    By least squares over their centres, which says nothing of how each robot turned by itself. Fewer than
    `MIN_MARKERS` tell no rotation, and the scale by their sides.
    """
    middle, target = before.centers.mean(), after.centers.mean()
    here, there = before.centers - middle, after.centers - target
    if here.size < MIN_MARKERS:
        a = complex(np.median(after.sides_px() / before.sides_px()))
    else:
        a = complex(np.vdot(here, there) / np.vdot(here, here).real)
    return a, complex(target - a * middle)


def carried(markers: LocalHomographies, motion: tuple[complex, complex]) -> LocalHomographies:
    """Return where a similarity (a, b) of the image takes markers.

    Relative squeezes `k / m̄` and horizons stay: the camera's tilt makes them, in the image's axes.
    """
    a, b = motion
    return replace(
        markers,
        centers=a * markers.centers + b,
        arms=a * markers.arms,
        squeezes=np.conj(a) * markers.squeezes,
    )


def shifts_sides(before: LocalHomographies, after: LocalHomographies) -> Array:
    """Return by how much (N,) markers' corners moved at most, in their sides."""
    moved_px = np.abs(after.images(SQUARE_CORNERS) - before.images(SQUARE_CORNERS)).max(axis=1)
    return np.asarray(moved_px / before.sides_px())


def find_quads_near(image: Image, markers: LocalHomographies) -> Array:
    """Return the corners (Q, 4, 2), px, of quadrilaterals near the places of N markers, in any order.

    If the places are most of the image, they are those of the whole image.
    """
    boxes = []
    for center, side_px in zip(markers.centers.tolist(), markers.sides_px().tolist(), strict=True):
        reach_px = REACH_SIDES * side_px
        columns, lines = (
            slice(max(0, math.floor(at - reach_px)), max(0, math.ceil(at + reach_px) + 1))
            for at in (center.real, center.imag)
        )
        boxes.append((image[lines, columns], (columns.start, lines.start)))
    if sum(box.size for box, _ in boxes) > MAX_SHARE * image.size:
        return find_quads(image)
    return np.concatenate([np.zeros((0, 4, 2)), *(find_quads(box) + corner for box, corner in boxes)])


def innermost(markers: LocalHomographies, image: Image) -> LocalHomographies:
    """Return the `NEAR_MARKERS` of N markers that are nearest to the image's middle.

    They move least when the camera climbs, turns or zooms.
    """
    height, width = image.shape
    order = np.argsort(np.abs(markers.centers - complex(width - 1, height - 1) / 2))
    return markers.take(order[:NEAR_MARKERS])
