"""Quadrilaterals that share a place, against OpenCV's test of points in polygons; readings of drawn ones."""

import cv2
import numpy as np
import pytest

from skyherd.markers.dictionary import marker_cells
from skyherd.vision.diagnosis import quad_reading
from skyherd.vision.diagnosis.places import contain, first_of_each_place, lie_on_markers
from skyherd.vision.diagnosis.quad_reading import read_outlines, read_quads, show_all_bits

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


def drawn_quads(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return an image of 32 markers, turned and mirrored, up to two bits flipped, four cut by the border."""
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
    return cv2.GaussianBlur(image, (0, 0), 2.0), np.array(quads)


@pytest.mark.parametrize("read", [read_quads, read_outlines])
def test_quads_are_read_together_as_each_by_itself(read, monkeypatch) -> None:
    """In blocks that end between them, with cut and unlike ones beside each other."""
    image, quads = drawn_quads(np.random.default_rng(4))
    quads = np.concatenate([quads, quads + np.array([37, 41]), quads[:, ::-1]])
    alone = [read(image, quad[None], "4X4_50")[0] for quad in quads]
    monkeypatch.setattr(quad_reading, "QUADS_AT_ONCE", 7)
    monkeypatch.setattr(quad_reading, "FINALISTS_AT_ONCE", 5)
    together = read(image, quads, "4X4_50")
    assert read(image, quads[:0], "4X4_50") == []
    for one, other in zip(alone, together, strict=True):
        assert (one.nearest_id, one.wrong_cells) == (other.nearest_id, other.wrong_cells)
        for name in ("corners_px", "cell_px", "black", "white", "quiet", "likeness", "visible"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-5, err_msg=name)


def test_likeness_is_the_correlation_with_the_marker() -> None:
    """Against NumPy's correlation of the cells that lie in the image, whole and cut, under no blur."""
    image = np.full((100, 100), 200, np.uint8)
    image[20:80, 20:80] = np.kron(np.where(marker_cells("4X4_50", 7), 180, 60), np.ones((10, 10)))
    image[40:50, 20:80] += 15  # a stripe that the marker has not
    for cut in (0, 45):
        quad = 6.0 * SQUARE + (20 - cut, 20) - 0.5
        (reading,) = read_quads(np.ascontiguousarray(image[:, cut:]), quad[None], "4X4_50")
        assert (reading.nearest_id, reading.wrong_bits) == (7, 0)
        cells = image[25:80:10, 25:80:10].astype(float)[:, (cut + 5) // 10 - 2 if cut else 0 :]
        wanted = np.corrcoef(cells.ravel(), marker_cells("4X4_50", 7)[:, -cells.shape[1] :].ravel())[0, 1]
        assert reading.likeness == pytest.approx(wanted, abs=0.03)
        assert reading.visible == pytest.approx(cells.shape[1] / 6)


def test_shown_bits_agree_with_readings() -> None:
    """Drawn markers, turned and mirrored, with up to two bits flipped, some cut by the border."""
    image, quads = drawn_quads(np.random.default_rng(4))
    shown = show_all_bits(image, quads, "4X4_50", 0.4)
    readings = read_quads(image, quads, "4X4_50")
    assert shown.tolist() == [reading.wrong_bits == 0 for reading in readings]
    assert 0 < shown.sum() < 32 and min(reading.visible for reading in readings) == 0.5
    assert not (show_all_bits(image, quads, "4X4_50", 0.6) & (np.arange(32) % 8 == 0)).any()
