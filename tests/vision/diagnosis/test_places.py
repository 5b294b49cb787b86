"""Quadrilaterals that share a place, against OpenCV's test of points in polygons."""

import cv2
import numpy as np
import pytest

from skyherd.vision.diagnosis.places import contain, first_of_each_place, lie_on_markers

SQUARE = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])


def inside(quad_px: np.ndarray, point_px: np.ndarray) -> bool:
    """Return what OpenCV says."""
    return cv2.pointPolygonTest(quad_px.astype(np.float32), point_px.tolist(), False) > 0


@pytest.mark.parametrize("seed", range(3))
def test_quadrilaterals_contain_points_as_opencv_says(seed) -> None:
    """Of any shape and orientation, concave and crossed ones included."""
    rng = np.random.default_rng(seed)
    quads, points = rng.uniform(0, 10, (200, 4, 2)), rng.uniform(0, 10, (200, 2))
    expected = [inside(quad, point) for quad, point in zip(quads, points, strict=True)]
    crossed = [not cv2.isContourConvex(quad.astype(np.float32)) for quad in quads]
    assert 0 < sum(expected) < 200 and any(crossed)
    assert contain(quads, points).tolist() == expected


def test_quadrilateral_on_inside_or_around_marker_is_known() -> None:
    centers, reaches = np.array([[50.0, 50]]), np.array([6.0])
    on, beside, around = SQUARE + 41, SQUARE + 60, SQUARE * 10 + (20, -10)
    assert lie_on_markers(np.array([on, beside, around]), centers, reaches).tolist() == [True, False, True]
    assert not lie_on_markers(np.array([on]), np.zeros((0, 2)), np.zeros(0)).any()


@pytest.mark.parametrize("seed", range(3))
def test_first_of_each_place_is_kept(seed) -> None:
    """Against all pairs, one after the other."""
    rng = np.random.default_rng(seed)
    quads = SQUARE * rng.uniform(0.5, 2, (80, 1, 1)) + rng.uniform(0, 60, (80, 1, 2))
    kept: list[int] = []
    for row, quad in enumerate(quads):
        if not any(inside(quads[k], quad.mean(axis=0)) or inside(quad, quads[k].mean(axis=0)) for k in kept):
            kept.append(row)
    assert 5 < len(kept) < 75
    assert first_of_each_place(quads).tolist() == kept
