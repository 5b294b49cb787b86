"""Drawn markers, whole, turned, mirrored and cut, and what is read of them."""

import cv2
import numpy as np
import pytest

from skyherd.markers.dictionary import marker_cells
from skyherd.vision.diagnosis.explain import _apart, _best_of_places
from skyherd.vision.diagnosis.reading import Cells, likeness_and_blurs, read_cut_squares
from skyherd.vision.search.dark import cut_squares, dark_outlines

DICTIONARY = "4X4_50"
SQUARE = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])


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
    corners = np.array([[[40, 40], [160, 40], [160, 160], [40, 160]]]) - 0.5
    codes = np.array([4 * 17])
    read = Cells.read(image, corners, DICTIONARY)
    assert not read.wrong(codes, DICTIONARY).any() and read.visible == 1 and read.dark_edges() == 0
    assert read.blacks[0] == pytest.approx(float(image[50, 100]), abs=10)
    assert read.margins.mean() - read.blacks[0] == pytest.approx(130, abs=15)
    likeness, blurs = likeness_and_blurs(image, corners, codes, DICTIONARY)
    assert likeness[0] > 0.999 and blurs[0] == pytest.approx(0.36)


def test_flipped_cells_are_named_in_the_order_of_the_marker() -> None:
    image, quads, ids, flipped = drawn_quads(np.random.default_rng(4))
    read = Cells.read(image, quads, DICTIONARY)
    wrong = read.wrong(4 * np.array(ids), DICTIONARY)
    for k in range(32):
        assert read.visible[k] == pytest.approx((6 - 3 * (k % 8 == 0)) / 6)
        cells = (np.argwhere(wrong[k]) + 1).tolist()
        assert cells == flipped[k] if k % 8 else all(cell in flipped[k] for cell in cells)
    assert sum(map(len, flipped)) > 20


def test_markers_are_read_together_as_each_by_itself() -> None:
    image, quads, ids, _ = drawn_quads(np.random.default_rng(4))
    codes = 4 * np.array(ids)
    together, alike = (
        Cells.read(image, quads, DICTIONARY),
        likeness_and_blurs(image, quads, codes, DICTIONARY),
    )
    for k in range(32):
        alone = Cells.read(image, quads[[k]], DICTIONARY)
        np.testing.assert_allclose(alone.levels, together.levels[[k]], rtol=1e-5)
        own = likeness_and_blurs(image, quads[[k]], codes[[k]], DICTIONARY)
        np.testing.assert_allclose([own[0][0], own[1][0]], [alike[0][k], alike[1][k]], rtol=1e-5)
    assert likeness_and_blurs(image, quads[:0], codes[:0], DICTIONARY)[0].size == 0


def test_likeness_is_the_correlation_with_the_marker() -> None:
    """Against NumPy's correlation of the cells that lie in the image, whole and cut, under no blur."""
    image = np.full((100, 100), 200, np.uint8)
    image[20:80, 20:80] = np.kron(np.where(marker_cells(DICTIONARY, 7), 180, 60), np.ones((10, 10)))
    image[40:50, 20:80] += 15  # a stripe that the marker has not
    for cut in (0, 40):
        quad = 6.0 * SQUARE + (20 - cut, 20) - 0.5
        shown = np.ascontiguousarray(image[:, cut:])
        likeness, _ = likeness_and_blurs(shown, quad[None], np.array([28]), DICTIONARY)
        cells = image[25:80:10, 25:80:10].astype(float)[:, max(cut // 10 - 2, 0) :]
        wanted = np.corrcoef(cells.ravel(), marker_cells(DICTIONARY, 7)[:, -cells.shape[1] :].ravel())[0, 1]
        assert likeness[0] == pytest.approx(wanted, abs=0.03)


def laid_out(marker_id: int, ground: int) -> np.ndarray:
    """A marker with a margin of a cell on a ground, turned by 17 degrees."""
    cells = np.pad(np.where(marker_cells(DICTIONARY, marker_id), 230, 30), 1, constant_values=230)
    image, side = np.full((140, 140), ground, np.uint8), 9 * len(cells)
    turn = cv2.getRotationMatrix2D((side / 2 - 0.5, side / 2 - 0.5), 17.0, 1.0)
    turn[:, 2] += 70 - side / 2
    drawn = np.kron(cells, np.ones((9, 9))).astype(np.uint8)
    cv2.warpAffine(drawn, turn, (140, 140), image, cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT)
    return cv2.GaussianBlur(image, (0, 0), 0.8)


def cut_markers(image: np.ndarray) -> dict[int, np.ndarray]:
    """The centre of the best square of each place, px, by its id."""
    read = read_cut_squares(image, cut_squares(dark_outlines(image), image, 6), DICTIONARY)
    read = read.take(_best_of_places(read.corners_px, read.correlations))
    return dict(zip(read.ids.tolist(), read.corners_px.mean(axis=1), strict=True))


@pytest.mark.parametrize("ground", [230, 120])
def test_markers_cut_by_the_border_are_read(ground) -> None:
    """A corner of each is beyond the right border."""
    for marker_id in (3, 21, 40):
        image = laid_out(marker_id, ground)
        last = int(np.argwhere(image.min(axis=0) < 60).max())
        found = cut_markers(np.ascontiguousarray(image[:, : last - 12]))
        assert list(found) == [marker_id]
        np.testing.assert_allclose(found[marker_id], (69.5, 69.5), atol=3)


def test_cut_markers_have_a_margin() -> None:
    """With a dark strip along one side, a third of a cell away, it is not read."""
    image = np.full((160, 200), 230, np.uint8)
    cells = np.kron(np.where(marker_cells(DICTIONARY, 3), 230, 30), np.ones((14, 14)))
    image[40:124, 100:184] = cells
    striped = image.copy()
    striped[40:124, 85:95] = 30
    cut, other = (cv2.GaussianBlur(one, (0, 0), 0.8)[:, :165].copy() for one in (image, striped))
    assert list(cut_markers(cut)) == [3] and cut_markers(other) == {}


def test_dark_corner_of_the_image_is_no_cut_marker() -> None:
    image = np.full((140, 140), 200, np.uint8)
    image[:60, 90:] = 30
    image[15:30, 100:125] = 200
    assert cut_markers(cv2.GaussianBlur(image, (0, 0), 0.8)) == {}


@pytest.mark.parametrize("seed", range(3))
def test_best_of_each_place_is_kept(seed) -> None:
    """Against all pairs of squares, one after the other by merit."""
    rng = np.random.default_rng(seed)
    sides, merits = rng.uniform(5, 20, 80), rng.uniform(0, 1, 80)
    quads = SQUARE * sides[:, None, None] / 10 + rng.uniform(0, 60, (80, 1, 2))
    middles, kept = quads.mean(axis=1), list[int]()
    for row in np.argsort(-merits):
        reach = [max(sides[row], sides[k]) / 2 for k in kept]
        if all(np.hypot(*(middles[row] - middles[k])) >= r for k, r in zip(kept, reach, strict=True)):
            kept.append(row)
    assert 5 < len(kept) < 75
    assert _best_of_places(quads, merits).tolist() == kept
    assert not _apart(quads, quads[kept]).any()
    assert _apart(quads[kept[1:]], quads[kept[:1]]).all()


def test_quadrilateral_on_inside_or_around_another_is_known() -> None:
    marker, on, beside, around = SQUARE + 40, SQUARE + 41, SQUARE + 60, SQUARE * 10 - (5, 5)
    assert _apart(np.array([on, beside, around]), marker[None]).tolist() == [False, True, False]
    assert _apart(np.array([on]), np.zeros((0, 4, 2))).all()
