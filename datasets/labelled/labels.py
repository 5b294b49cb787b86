"""Labels of one image, rounded once, so that the truth table and all formats have the same digits."""

from dataclasses import dataclass

import numpy as np

from skyherd.datasets.labelled.scenes import Scene, corners_m
from skyherd.geometry import Array, IntArray

KEYPOINTS = ("front_left", "front_right", "back_right", "back_left", "center")
"""Keypoints of a marker: corners 0 to 3, the first two ahead, and the centre."""

OUTSIDE, COVERED, SEEN = 0, 1, 2
"""Visibility of a keypoint. Defined by COCO: 0 outside the image, 1 covered, 2 visible."""

DIGITS = 9
"""Decimals of all labels. Chosen: far below the accuracy of measurements, and above the rounding errors of
doubles."""


@dataclass(frozen=True)
class Labels:
    """Ground truth of the N markers of an image that are at least partly visible.

    Attributes:
        ids: (N,) markers, ascending.
        centers_px: (N, 2) images of the markers' centres; an integer is a pixel centre.
        headings_deg: (N,) directions of the forward axes at the centres, from +u to +v.
        sides_px: (N,) `sqrt(|det J|)` of the map from marker sides to pixels, at the centre.
        corners_px: (N, 4, 2) corners of the black squares, the two front ones first: left, right.
        visible_fractions: (N,) fractions of the black squares that are in the image and not covered.
        visibilities: (N, 5) of the keypoints: 0 outside the image, 1 covered, 2 visible.
        crb_stds: (N, 3) Cramér–Rao standard deviations of u px, v px, heading deg, of wholly visible markers.
    """

    ids: IntArray
    centers_px: Array
    headings_deg: Array
    sides_px: Array
    corners_px: Array
    visible_fractions: Array
    visibilities: IntArray
    crb_stds: Array

    @property
    def keypoints_px(self) -> Array:
        """Keypoints (N, 5, 2) of each marker, px: its corners and its centre."""
        return np.concatenate([self.corners_px, self.centers_px[:, None]], axis=1)

    def __len__(self) -> int:
        return int(self.ids.size)


def make_labels(scene: Scene) -> Labels:
    """Make the labels of a scene's markers that are at least partly visible."""
    truth = scene.truth
    keep = truth.visible_fractions > 0
    stds = np.sqrt(np.diagonal(scene.bounds(), axis1=1, axis2=2)) * (1.0, 1.0, np.degrees(1.0))
    return Labels(
        ids=truth.ids[keep],
        centers_px=truth.centers_px[keep].round(DIGITS),
        headings_deg=np.degrees(truth.headings_rad[keep]).round(DIGITS),
        sides_px=truth.sides_px[keep].round(DIGITS),
        corners_px=truth.corners_px[keep].round(DIGITS),
        visible_fractions=truth.visible_fractions[keep].round(DIGITS),
        visibilities=_visibilities(scene)[keep],
        crb_stds=stds[keep].round(DIGITS),
    )


def _visibilities(scene: Scene) -> IntArray:
    """Return the visibilities (N, 5) of all markers' keypoints."""
    truth, size = scene.truth, np.array(scene.camera.size_px)
    points_px = np.concatenate([truth.corners_px, truth.centers_px[:, None]], axis=1)
    corners = corners_m(scene.positions_m, scene.headings_rad, 1.0)
    points_m = np.concatenate([corners, scene.positions_m[:, None]], axis=1)
    covered = np.zeros(points_m.shape[:2], dtype=bool)
    for occluder in scene.occluders:
        covered |= occluder.make().covers(points_m)
    inside = ((points_px >= -0.5) & (points_px <= size - 0.5)).all(axis=2)
    return np.where(inside, np.where(covered, COVERED, SEEN), OUTSIDE).astype(np.int64)
