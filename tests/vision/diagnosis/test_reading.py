"""Drawn markers, whole, turned, mirrored and cut, and what is read of them."""

import cv2
import numpy as np
import pytest

from skyherd.markers.dictionary import marker_cells
from skyherd.vision.diagnosis.reading import Named, Reading, depths, name_quads, read_markers
from skyherd.vision.search.decode import DecodedQuads

DICTIONARY = "4X4_50"
SQUARE = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])


def read(image: np.ndarray, quads: np.ndarray, ids: list[int], *, mirrored: bool = False) -> list[Reading]:
    """Read given markers at given corners alone."""
    ones = np.ones(len(ids))
    named = Named(DecodedQuads(np.array(ids), quads, ones, ones), np.full(len(ids), mirrored))
    return read_markers(image, named, quads, DICTIONARY)


def drawn_quads(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, list[int], list[list[list[int]]]]:
    """Return an image of 32 markers, their corners and ids, and cells that are flipped, up to two of each.

    The first in each row is cut by the border, and the last four in each row are mirrored.
    """
    image, quads, ids, flipped = np.full((400, 800), 200, np.uint8), [], [], []
    for place in range(32):
        ids.append(int(rng.integers(50)))
        cells = marker_cells(DICTIONARY, ids[-1]).copy()
        flips = np.unique(rng.integers(1, 5, (int(rng.integers(3)), 2)), axis=0)
        cells[tuple(flips.T)] ^= True
        mirrored, turns = place % 8 >= 4, place % 4
        cells = cells[:, ::-1] if mirrored else cells
        u, v = 100 * (place % 8) + (-30 if place % 8 == 0 else 20), 100 * (place // 8) + 20
        drawn = np.kron(np.where(np.rot90(cells, -turns), 200, 40), np.ones((10, 10))).astype(np.uint8)
        image[v : v + 60, max(u, 0) : u + 60] = drawn[:, max(-u, 0) :]
        corners = np.roll(6.0 * SQUARE + (u, v) - 0.5, -turns, axis=0)
        quads.append(corners[[1, 0, 3, 2]] if mirrored else corners)
        flipped.append((flips + 1).tolist())
    return cv2.GaussianBlur(image, (0, 0), 2.0), np.array(quads), ids, flipped


def test_a_drawn_marker_is_read_with_its_levels_and_blur() -> None:
    """Blurred by a Gaussian of 0.36 cells, which is tabulated: likeness 1 except for sampling."""
    cells = np.pad(np.where(marker_cells(DICTIONARY, 17), 200, 40), 2, constant_values=200).astype(np.uint8)
    image = cv2.GaussianBlur(np.kron(cells, np.ones((20, 20), np.uint8)), (0, 0), 7.2)
    corners = np.array([[40, 40], [160, 40], [160, 160], [40, 160]]) - 0.5
    (reading,) = read(image, corners[None], [17])
    assert reading.wrong_bits == 0 and reading.likeness > 0.999 and reading.framed
    assert (reading.black, reading.white) == (pytest.approx(40, abs=3), pytest.approx(200, abs=3))
    assert reading.blur_cells == pytest.approx(0.36) and reading.cell_px.tolist() == pytest.approx([20, 20])
    assert reading.side_px == pytest.approx(120)
    at_middle = float(image[100, 170]) - float(image[100, 50])
    assert reading.depth == pytest.approx(at_middle, abs=10)
    assert depths(image, corners[None], DICTIONARY)[0] == pytest.approx(at_middle, abs=10)


def test_flipped_cells_are_named_in_the_order_of_the_marker() -> None:
    image, quads, ids, flipped = drawn_quads(np.random.default_rng(4))
    mirrored = np.arange(32) % 8 >= 4
    for rows in (~mirrored, mirrored):
        few = np.flatnonzero(rows)
        readings = read(image, quads[rows], [ids[k] for k in few], mirrored=bool(mirrored[few[0]]))
        for k, reading in zip(few.tolist(), readings, strict=True):
            in_image = 6 - 3 * (k % 8 == 0)
            assert reading.visible == pytest.approx(in_image / 6)
            wrong = [list(cell) for cell in reading.wrong_cells]
            assert wrong == flipped[k] if k % 8 else all(cell in flipped[k] for cell in wrong)
    assert sum(map(len, flipped)) > 20


def test_drawn_markers_are_named_with_turn_and_mirror_image() -> None:
    """Each whole marker without a flipped cell is named after its id, in the order of its corners."""
    image, quads, ids, flipped = drawn_quads(np.random.default_rng(4))
    whole = [k for k in range(32) if k % 8 and not flipped[k]]
    clockwise = np.array([quads[k][::-1] if k % 8 >= 4 else quads[k] for k in whole])
    named = name_quads(image, clockwise, DICTIONARY)
    for k in whole:
        rows = np.flatnonzero(np.linalg.norm(named.decoded.corners_px - quads[k], axis=2).max(axis=1) < 1e-6)
        best = rows[np.argmax(named.decoded.correlations[rows])]
        assert (named.decoded.ids[best], named.mirrored[best]) == (ids[k], k % 8 >= 4)
        assert named.decoded.correlations[best] > 0.98
    assert len(whole) >= 5


def test_markers_are_read_together_as_each_by_itself() -> None:
    image, quads, ids, _ = drawn_quads(np.random.default_rng(4))
    alone = [read(image, quads[[k]], [ids[k]])[0] for k in range(32)]
    for one, other in zip(alone, read(image, quads, ids), strict=True):
        assert one.wrong_cells == other.wrong_cells
        for name in ("corners_px", "cell_px", "black", "white", "quiet", "likeness", "visible"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-5, err_msg=name)
    assert read(image, quads[:0], []) == []


def test_likeness_is_the_correlation_with_the_marker() -> None:
    """Against NumPy's correlation of the cells that lie in the image, whole and cut, under no blur."""
    image = np.full((100, 100), 200, np.uint8)
    image[20:80, 20:80] = np.kron(np.where(marker_cells(DICTIONARY, 7), 180, 60), np.ones((10, 10)))
    image[40:50, 20:80] += 15  # a stripe that the marker has not
    for cut in (0, 40):
        quad = 6.0 * SQUARE + (20 - cut, 20) - 0.5
        (reading,) = read(np.ascontiguousarray(image[:, cut:]), quad[None], [7])
        assert reading.wrong_bits == 0
        cells = image[25:80:10, 25:80:10].astype(float)[:, max(cut // 10 - 2, 0) :]
        wanted = np.corrcoef(cells.ravel(), marker_cells(DICTIONARY, 7)[:, -cells.shape[1] :].ravel())[0, 1]
        assert reading.likeness == pytest.approx(wanted, abs=0.03)
        assert reading.visible == pytest.approx(cells.shape[1] / 6)
