"""Quadrilaterals that share a place, against OpenCV's test of points in polygons and drawn markers."""

import cv2
import numpy as np
import pytest

from skyherd.markers.dictionary import marker_cells
from skyherd.vision.diagnosis.cell_samples import PER_CELL, image_from_cells, sample_cells, sample_middles
from skyherd.vision.diagnosis.places import contain, first_of_each_place, lie_on_markers
from skyherd.vision.diagnosis.quad_reading import read_quad, show_all_bits

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


def test_middles_of_cells_are_those_of_all_samples() -> None:
    """Up to the 1/32 px to which OpenCV warps, where the image changes by 4 levels/px."""
    v, u = np.mgrid[:80, :60].astype(float)
    image = (2 * u + v + 20 * np.sin(u / 6)).astype(np.uint8)
    quads = np.array([[[5.0, 8], [50, 4], [55, 60], [9, 48]], [[-20, 20], [30, 10], [40, 70], [-10, 60]]])
    levels, seen = sample_middles(image, quads, 6)
    assert seen[0].all() and 0 < seen[1].sum() < 36
    middles = slice(PER_CELL // 2, None, PER_CELL)
    for row, quad in enumerate(quads):
        expected = sample_cells(image, image_from_cells(quad, 6), 6)[middles, middles][1:-1, 1:-1].ravel()
        assert (np.isfinite(expected) == seen[row]).all()
        np.testing.assert_allclose(levels[row][seen[row]], expected[seen[row]], atol=4 / 32 + 0.5)


def test_shown_bits_agree_with_readings() -> None:
    """Drawn markers, turned and mirrored, with up to two bits flipped, some cut by the border."""
    rng = np.random.default_rng(4)
    image, quads = np.full((400, 800), 200, np.uint8), []
    for place in range(32):
        cells = np.rot90(marker_cells("4X4_50", int(rng.integers(50))), place % 4).copy()
        cells = cells[:, ::-1] if place % 8 >= 4 else cells
        for row, column in rng.integers(1, 5, (int(rng.integers(3)), 2)):
            cells[row, column] ^= True
        u, v = 100 * (place % 8) + (-30 if place % 8 == 0 else 20), 100 * (place // 8) + 20
        drawn = np.kron(np.where(cells, 200, 40), np.ones((10, 10))).astype(np.uint8)
        image[v : v + 60, max(u, 0) : u + 60] = drawn[:, max(-u, 0) :]
        quads.append(6.0 * SQUARE + (u, v) - 0.5)
    image = cv2.GaussianBlur(image, (0, 0), 2.0)
    shown = show_all_bits(image, np.array(quads), "4X4_50", 0.4)
    readings = [read_quad(image, quad, "4X4_50") for quad in quads]
    assert shown.tolist() == [reading.wrong_bits == 0 for reading in readings]
    assert 0 < shown.sum() < 32 and min(reading.visible for reading in readings) == 0.5
    assert not (show_all_bits(image, np.array(quads), "4X4_50", 0.6) & (np.arange(32) % 8 == 0)).any()
