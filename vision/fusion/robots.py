"""Detections of robots, from the homographies of their ground planes, and groups of markers that agree."""

from collections.abc import Sequence

import numpy as np

from skyherd.geometry import ROBOT_FRAME_CORNERS, Array, ComplexArray, IntArray, to_points
from skyherd.messages import Detections

MAX_APART_SIDES = 0.5
"""Maximum distance between the robot's places by two of its markers, sides. Chosen: far above errors, and
below the distance of two robots."""


def group_by_place(
    robots: IntArray, markers: IntArray, places_px: ComplexArray, sides_px: Array
) -> list[IntArray]:
    """Return groups of detections that agree on a robot's place, with each marker once, by ascending robot.

    Args:
        robots: (K,) the robot of each detection.
        markers: (K,) the marker of each.
        places_px: (K,) the robot's reference point by each, `u + iv`.
        sides_px: (K,) size of a marker side by each.
    """
    groups: list[list[int]] = []
    for row in np.argsort(robots, kind="stable").tolist():
        for group in groups:
            first = group[0]
            near = abs(places_px[row] - places_px[first]) <= MAX_APART_SIDES * sides_px[row]
            if robots[first] == robots[row] and near and markers[row] not in markers[group]:
                group.append(row)
                break
        else:
            groups.append([row])
    return [np.array(group) for group in groups]


def detections_of_robots(
    found: Detections,
    groups: Sequence[IntArray],
    robots: IntArray,
    homographies: Array,
    covariances: Array,
    others: Detections,
) -> Detections:
    """Return the detections of R robots, followed by other detections.

    Args:
        found: detections of the markers.
        groups: rows of the markers of each robot.
        robots: (R,) ids.
        homographies: (R, 3, 3) from each robot's plane (forward, left), marker sides, to pixels.
        covariances: (R, 3, 3) of (u, v, heading).
        others: detections of other markers in the same image.
    """
    homographies = homographies.reshape(-1, 3, 3)
    corners = np.array([apply(homography, ROBOT_FRAME_CORNERS) for homography in homographies])
    centers = np.array([apply(homography, np.zeros(1)) for homography in homographies])
    slopes = np.array([derivatives(homography, np.zeros(1))[0] for homography in homographies])
    slopes, count = slopes.reshape(-1, 2, 2), len(groups)
    qualities = np.array([found.qualities[members].min() for members in groups], dtype=np.int64)
    return Detections(
        unit_id=found.unit_id,
        time_s=found.time_s,
        image_size_px=found.image_size_px,
        ids=np.concatenate([robots, others.ids]),
        centers_px=np.concatenate([to_points(centers.reshape(count)), others.centers_px]),
        headings_rad=np.concatenate([np.arctan2(slopes[:, 1, 0], slopes[:, 0, 0]), others.headings_rad]),
        sides_px=np.concatenate([np.sqrt(np.abs(np.linalg.det(slopes))), others.sides_px]),
        corners_px=np.concatenate([to_points(corners.reshape(count, 4)), others.corners_px]),
        covariances=np.concatenate([covariances.reshape(-1, 3, 3), others.covariances]),
        qualities=np.concatenate([qualities, others.qualities]),
    )


def apply(homography: Array, points: ComplexArray | Array) -> ComplexArray:
    """Return the images (K,), `u + iv`, of plane points (K,)."""
    mapped = _homogeneous(points) @ homography.T
    return np.asarray((mapped[:, 0] + 1j * mapped[:, 1]) / mapped[:, 2])


def derivatives(homography: Array, points: ComplexArray | Array) -> Array:
    """Return the derivatives (K, 2, 2) of a homography at plane points (K,)."""
    mapped = _homogeneous(points) @ homography.T
    depth = mapped[:, 2, None, None]
    pixels = mapped[:, :2, None] / depth
    return np.asarray((homography[:2, :2] - pixels * homography[2, :2]) / depth)


def _homogeneous(points: ComplexArray | Array) -> Array:
    return np.stack([points.real, points.imag, np.ones(len(points))], axis=1)
