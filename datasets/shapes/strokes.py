"""Distribution of robots along curves, and polylines as shapes."""

from collections.abc import Sequence
from heapq import heapify, heapreplace

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array, to_complex, to_points

CLOSED_SHARE = 0.05
"""Distance of the last corner from the first below which a polyline is closed, as a share of its length.
Chosen: a click that is meant to hit the first corner."""

MIN_SPACING = 0.6
"""Minimum distance of two robots, in mean distances between neighbours on a stroke. Chosen: nearer robots
would look like a joint, or collide."""


MIN_POLYLINE_SPACING = 0.3
"""The same for a polyline. Chosen: lower, since lines that are drawn by hand are less regular."""


def divide(lengths: Sequence[float], parts: Sequence[int], spare: int) -> list[int]:
    """Return the numbers of parts into which curves are divided, after `spare` more parts.

    Webster's rule: the next part goes to the curve with the largest length over `parts + 1/2`. This minimizes
    the deviation of the parts from their mean.

    Args:
        lengths: length of each curve.
        parts: parts of each curve so far, at least 1.
        spare: number of additional parts.
    """
    divided = list(parts)
    queue = [(-length / (part + 0.5), k) for k, (length, part) in enumerate(zip(lengths, parts, strict=True))]
    heapify(queue)
    for _ in range(spare):
        k = queue[0][1]
        divided[k] += 1
        heapreplace(queue, (-lengths[k] / (divided[k] + 0.5), k))
    return divided


def polyline_points(corners: Array, count: int) -> tuple[Array, list[int]]:
    """Return the points (N, 2) of robots along a polyline, and their order as a line, from 0.

    The polyline is closed if its last corner is near its first. A robot stands at each corner, unless there
    are more corners than robots: then the robots are at equal distances along the line.

    Args:
        corners: (M, 2) corners.
        count: number N of robots, at least 2.

    Raises:
        InputError: there are fewer than two different corners, or two robots would be too close.
    """
    bends = to_complex(np.asarray(corners, dtype=float))
    bends = bends[np.append(True, np.abs(np.diff(bends)) > 0)] if bends.size else bends
    if bends.size < 2:
        raise InputError("corners", f"{bends.size} different ones", "at least 2")
    length = float(np.abs(np.diff(bends)).sum())
    is_closed = bends.size > 3 and abs(bends[-1] - bends[0]) < CLOSED_SHARE * length
    if is_closed:
        bends = np.append(bends[:-1], bends[0])
    lengths = np.abs(np.diff(bends))
    segments = count if is_closed else count - 1
    if lengths.size <= segments:
        parts = divide(lengths.tolist(), [1] * lengths.size, segments - lengths.size)
        ways = [np.arange(part) / part for part in parts]
        at = np.concatenate([k + way for k, way in enumerate(ways)])
        at = at if is_closed else np.append(at, lengths.size)
    else:
        along = np.append(0.0, np.cumsum(lengths))
        at = np.interp(along[-1] * np.arange(count) / segments, along, np.arange(along.size))
    steps = np.arange(bends.size)
    points = np.interp(at, steps, bends.real) + 1j * np.interp(at, steps, bends.imag)
    apart = np.abs(points[:, None] - points)
    np.fill_diagonal(apart, np.inf)
    if apart.min() < MIN_POLYLINE_SPACING * lengths.sum() / segments:
        raise InputError("corners", "two robots would be too close", "a line whose parts are farther apart")
    return to_points(points), [*range(count), *([0] if is_closed else [])]
