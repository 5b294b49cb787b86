"""Exact projection of a team's markers into many cameras at one instant, without shutter and motion.

Runs without rendered images (`perception = "ideal"` or `"noisy"`) need only the markers' image points. Robots
far from a camera's footprint are excluded first. One matrix product then projects all others for all cameras,
so that the work grows with the visible markers, not with cameras times robots.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray, inverse
from skyherd.render.camera.camera import Camera, CameraPose, distort, homography_image_ground
from skyherd.render.truth import SQUARE, ground_markers

BEYOND = 1 + 1e-9
"""Factor on the radius within which robots count as near a footprint. *Chosen*: 1e-9 m per metre, so that
rounding of the corners excludes no robot in view."""


@dataclass(frozen=True)
class TeamImage:
    """Markers whose whole card is in one camera's image: M rows of the team.

    Attributes:
        rows: (M,) row numbers of the markers in the team.
        centers_px: (M, 2) images of the centres.
        corners_px: (M, 4, 2) images of the black squares' corners, in the marker's order.
    """

    rows: IntArray
    centers_px: Array
    corners_px: Array


def project_team(
    views: Sequence[tuple[Camera, CameraPose]],
    positions_m: Array,
    headings_rad: Array,
    side_m: float,
    card_side_m: float,
) -> Iterator[TeamImage]:
    """Project a team's markers into many views.

    The points equal those of `project_markers` for the same camera and pose, without motion.

    Args:
        views: camera and pose of each image.
        positions_m: (N, 2) marker centres on the ground.
        headings_rad: (N,) forward directions of the markers, counter-clockwise from +x.
        side_m: side of the black square.
        card_side_m: side of the white card around it.

    Yields:
        The markers of each view whose whole card is in the image, in the order of the views.
    """
    if not views:
        return
    grounds = ground_markers(positions_m, headings_rad, side_m)
    images_ground = np.array([homography_image_ground(camera, pose) for camera, pose in views])
    view, row = np.nonzero(_near(views, images_ground, positions_m))
    matrices = images_ground[view] @ grounds[row]
    points = np.concatenate([np.zeros((1, 2)), SQUARE, SQUARE * (card_side_m / side_m)])
    mapped = np.column_stack([points, np.ones(len(points))]) @ matrices.transpose(0, 2, 1)
    pixels = mapped[..., :2] / mapped[..., 2:]
    ends = np.searchsorted(view, np.arange(len(views) + 1))
    parts = [slice(begin, end) for begin, end in pairwise(ends.tolist())]
    for part, (camera, pose) in zip(parts, views, strict=True):
        if camera.distortion:
            pixels[part] = distort(camera, pose.zoom, pixels[part])
    limits = np.array([camera.size_px for camera, _ in views])[view, None] - 0.5
    cards, ahead = pixels[:, 5:], (mapped[:, 5:, 2] > 0).all(axis=1)
    whole = np.asarray(((cards >= -0.5) & (cards <= limits)).all(axis=(1, 2)) & ahead)
    for part in parts:
        seen = np.flatnonzero(whole[part]) + part.start
        yield TeamImage(row[seen], pixels[seen, 0], pixels[seen, 1:5])


def _near(views: Sequence[tuple[Camera, CameraPose]], images_ground: Array, positions_m: Array) -> BoolArray:
    """Return the mask (V, N) of markers that may be in view.

    Without distortion the footprint is a quadrilateral, inside the smallest circle around the mean of its
    corners that contains them. With distortion, or the horizon in view, all markers may be in view.
    """
    bent = np.array([bool(camera.distortion) for camera, _ in views])
    corners_px = np.array([camera.corners_px for camera, _ in views])
    grounds_image = inverse(images_ground)
    homogeneous = np.concatenate([corners_px, np.ones((*corners_px.shape[:2], 1))], axis=2)
    mapped = homogeneous @ grounds_image.transpose(0, 2, 1)
    corners_m = mapped[..., :2] / mapped[..., 2:]
    middles_m = corners_m.mean(axis=1)
    reach_m = BEYOND * np.linalg.norm(corners_m - middles_m[:, None], axis=2).max(axis=1)
    reach_m[(mapped[..., 2] <= 0).any(axis=1) | bent] = np.inf
    away_m2 = ((positions_m - middles_m[:, None]) ** 2).sum(axis=2)
    return np.asarray(away_m2 <= reach_m[:, None] ** 2)
