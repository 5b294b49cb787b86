"""Decoding of quadrilaterals: rotations, blur, print contrast, several dictionaries, mirror images."""

import numpy as np
import pytest

from skyherd.geometry import SQUARE_CORNERS, to_points
from skyherd.markers.dictionary import cells_per_side, dictionary_size
from skyherd.vision import PhotometricDetector
from skyherd.vision.blurred_cells import standardised
from skyherd.vision.native.library import library
from skyherd.vision.native.search_library import CodeColumns, CodeTable
from skyherd.vision.search import decode
from skyherd.vision.search.decode import (
    BLUR_STEP,
    BLURRED_CELLS,
    BLURRED_CORRELATION,
    MIN_CORRELATION,
    blurred_codes,
    decode_quads,
)

SIGMA_PX = 0.85
OWN_MIRROR_IMAGES = {8, 9, 17, 47}  # of 4X4_50 from the bits


def grid(place_markers, side_px, headings):
    step = 2.0 * side_px + 8
    count = len(headings)
    columns = int(np.ceil(np.sqrt(count)))
    rows = -(-count // columns)
    index = np.arange(count)
    centers = step * ((index % columns + 0.5) + 1j * (index // columns + 0.5))
    matrices = place_markers(centers, headings, side_px)
    square = np.concatenate([to_points(SQUARE_CORNERS), np.ones((4, 1))], axis=1)
    corners = square @ matrices.transpose(0, 2, 1)
    return matrices, corners[..., :2], (int(step * columns), int(step * rows))


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("dictionary", ["4X4_50", "5X5_100", "APRILTAG_36h11"])
def test_decode_finds_rotation_and_orders_corners(place_markers, draw_markers, dictionary, turn):
    """4 px a cell, noise 5, corner errors of half a pixel: all ids are right, corners are only rotated."""
    rng = np.random.default_rng([1, turn])
    ids = rng.permutation(dictionary_size(dictionary))[:25]
    side = 4.0 * cells_per_side(dictionary)
    matrices, corners, size = grid(place_markers, side, rng.uniform(-np.pi, np.pi, ids.size))
    image = draw_markers(matrices, ids, size, rng, dictionary=dictionary)
    rough = corners + rng.uniform(-0.5, 0.5, corners.shape)
    found = decode_quads(image, np.roll(rough, turn, axis=1), dictionary, SIGMA_PX)
    assert found.ids.tolist() == ids.tolist()
    np.testing.assert_array_equal(found.corners_px, rough)
    assert (found.correlations >= MIN_CORRELATION).all() and (found.correlations <= 1 + 1e-6).all()


@pytest.mark.parametrize("assumed_px", [1.23, 0.6])
def test_small_blurred_markers_decode_by_their_grey_levels(place_markers, draw_markers, assumed_px):
    """2 px a cell under a blur of 1.23 px, known or not. Cells run together; at least 48 of 50 decode."""
    rng = np.random.default_rng(2)
    matrices, corners, size = grid(place_markers, 12.0, rng.uniform(-np.pi, np.pi, 50))
    image = draw_markers(matrices, range(50), size, rng, psf_px=1.2)
    found = decode_quads(image, corners, "4X4_50", assumed_px)
    at = {tuple(c): i for i, c in enumerate(corners[:, 0])}
    right = [i for i, c in zip(found.ids, found.corners_px, strict=True) if at.get(tuple(c[0])) == i]
    assert len(right) >= 48


@pytest.mark.smoke
def test_correlation_is_independent_of_gain_and_offset(place_markers, draw_markers):
    rng = np.random.default_rng(3)
    matrices, corners, size = grid(place_markers, 40.0, rng.uniform(-np.pi, np.pi, 9))
    image = draw_markers(matrices, range(9), size, rng, noise=0.0)
    faint = np.rint(90 + 0.4 * image).astype(np.uint8)
    one, other = (decode_quads(view, corners, "4X4_50", SIGMA_PX) for view in (image, faint))
    assert one.ids.tolist() == other.ids.tolist() == list(range(9))
    # Rounding to 8 bits has a standard deviation of 0.3 of 80 grey levels a pixel.
    np.testing.assert_allclose(one.correlations, other.correlations, atol=2e-3)


@pytest.mark.parametrize("levels", [(30, 230), (90, 150)])
@pytest.mark.parametrize("side_px", [8.0, 12.0, 30.0])
def test_print_contrast_is_that_of_the_levels_under_known_blur(place_markers, draw_markers, side_px, levels):
    """(white - black) / white, up to 1/8 less in the median: interpolation adds blur to cells of 2 px."""
    rng = np.random.default_rng([5, int(side_px)])
    matrices, corners, size = grid(place_markers, side_px, rng.uniform(-np.pi, np.pi, 16))
    drawn = draw_markers(matrices, range(16), size, rng, noise=2.0)
    black, white = levels
    image = np.rint(black + (white - black) / 200 * (drawn.astype(float) - 30)).astype(np.uint8)
    found = decode_quads(image, corners, "4X4_50", SIGMA_PX)
    assert found.ids.size == 16
    share = np.median(found.print_contrasts) / (1 - black / white)
    assert 7 / 8 - 0.01 < share < 1.02


def test_uniform_quadrilaterals_and_none_give_no_candidates():
    flat = np.full((60, 60), 77, np.uint8)
    quad = np.array([[[10.0, 10], [40, 10], [40, 40], [10, 40]]])
    assert not decode_quads(flat, quad, "4X4_50", SIGMA_PX).ids.size
    assert not decode_quads(flat, np.zeros((0, 4, 2)), "4X4_50", SIGMA_PX).ids.size


@pytest.mark.parametrize(
    "dictionary", ["4X4_50", pytest.param("5X5_100", marks=pytest.mark.slow), "APRILTAG_36h11"]
)
def test_mirrored_image_gives_no_wrong_id(place_markers, draw_markers, dictionary):
    """Four markers of 4X4_50 are symmetric and keep their ids. The other dictionaries have no such marker."""
    rng = np.random.default_rng(4)
    ids = np.arange(min(dictionary_size(dictionary), 100))
    side = 5.0 * cells_per_side(dictionary)
    matrices, _, size = grid(place_markers, side, rng.uniform(-np.pi, np.pi, ids.size))
    image = draw_markers(matrices, ids, size, rng, dictionary=dictionary)
    assert PhotometricDetector(dictionary).detect(image).ids.tolist() == ids.tolist()
    mirrored = PhotometricDetector(dictionary).detect(np.ascontiguousarray(image[:, ::-1]))
    allowed = OWN_MIRROR_IMAGES if dictionary == "4X4_50" else set()
    assert set(mirrored.ids.tolist()) == allowed


def table_of(codes):
    """Return codes (M, K) as a table; means and deviations tell them apart."""
    numbers = np.arange(1.0, len(codes) + 1)
    return CodeTable(CodeColumns.of(codes), numbers, 2 * numbers)


@pytest.mark.parametrize("count", [1, 7, 32, 33, 2348])
@pytest.mark.parametrize("rows", [0, 1, 4, 9, 20])
def test_best_code_is_that_of_the_products_in_double_precision(rows, count) -> None:
    """Sums of 64 products of single precision are exact to 64 roundings of their size."""
    rng = np.random.default_rng([6, rows, count])
    cells, codes = (rng.normal(0, 1, (size, 64)).astype(np.float32) for size in (rows, count))
    samples = standardised(cells.astype(float))
    expected = samples @ codes.astype(float).T
    bound = 65 * np.finfo(np.float32).eps * (np.abs(samples) @ np.abs(codes).astype(float).T)
    every = library().code_products(samples.astype(np.float32), CodeColumns.of(codes))
    assert (np.abs(every - expected) <= bound).all()
    never = [2.0]
    found = library().decoded(cells, np.zeros(rows, np.int32), [table_of(codes)], never, decode.CONSTANTS)
    best = expected.argmax(axis=1)
    assert found["code"].tolist() == best.tolist()
    at = np.arange(rows), best
    assert (np.abs(64 * found["likeness"] - expected[at]) <= bound[at]).all()
    np.testing.assert_allclose(found["deviation"], cells.astype(float).std(axis=1), rtol=1e-12)
    contrasts = found["likeness"] * found["deviation"] / (2 * (best + 1))
    whites = cells.astype(float).mean(axis=1) + contrasts * (best + 1)
    np.testing.assert_allclose(found["print_contrast"], contrasts / np.maximum(whites, 1.0), rtol=1e-9)


def test_first_of_equal_codes_is_the_best() -> None:
    """Rows of one code among those of others: ids do not depend on how many numbers a vector holds."""
    codes = np.full((90, 5), -1, dtype=np.float32)
    codes[[19, 20, 51, 77]] = [2, 1, 0, -1, -2]
    cells, tables = np.tile(codes[19], (3, 1)), np.zeros(3, np.int32)
    found = library().decoded(cells, tables, [table_of(codes)], [2.0], decode.CONSTANTS)
    assert found["code"].tolist() == [19, 19, 19]


@pytest.mark.parametrize(
    ("least", "needed", "is_last"), [(0.5, 0.9, True), (0.7, 0.9, False), (0.5, 0.99, False)]
)
def test_row_like_its_own_table_is_compared_with_the_last_one(least, needed, is_last) -> None:
    """A row has 0.6 with the code of its table, 0.95 with that of the last, and 1 with that of another."""
    rng = np.random.default_rng(7)
    own, other, third = np.linalg.qr(rng.normal(0, 1, (50, 3)) - rng.normal(0, 1, 3))[0].T
    basis = standardised(np.linalg.qr(np.stack([np.ones(50), own, other, third], axis=1))[0][:, 1:].T)
    row = 0.6 * basis[0] + 0.8 * basis[1]
    last = 0.95 * row + np.sqrt(1 - 0.95**2) * basis[2]
    tables = [table_of(np.float32([code])) for code in (basis[0], row, last)]
    cells = (100 + 20 * row).astype(np.float32)[None]
    found = library().decoded(cells, np.zeros(1, np.int32), tables, [least, 0.0, needed], decode.CONSTANTS)
    np.testing.assert_allclose(found["likeness"], 0.95 if is_last else 0.6, atol=1e-5)


@pytest.mark.parametrize("dictionary", ["4X4_50", "APRILTAG_36h11"])
def test_no_quad_that_may_be_blurred_is_left_out(dictionary) -> None:
    """Rows with just the least correlation with a blurred code; some come close to the bound on the other."""
    rng, gaps = np.random.default_rng(9), []
    blurred = blurred_codes(dictionary, BLURRED_CELLS).columns.columns.T[:200].astype(float)
    n2 = blurred.shape[1]
    for bucket in range(-12, 4):
        least = decode._least_likeness(dictionary, bucket)
        usual = (
            blurred_codes(dictionary, BLUR_STEP**bucket).columns.columns[:, : len(blurred)].T.astype(float)
        )
        away = np.concatenate([blurred - usual, rng.normal(size=blurred.shape)])
        codes = np.tile(blurred, (2, 1))
        away -= (away * codes).sum(axis=1, keepdims=True) * codes / n2
        away *= np.sqrt(n2 / np.maximum((away**2).sum(axis=1, keepdims=True), 1e-9))
        rows = BLURRED_CORRELATION * codes + np.sqrt(1 - BLURRED_CORRELATION**2) * away
        rows = rows[(away**2).sum(axis=1) > n2 / 2]
        of_usual = blurred_codes(dictionary, BLUR_STEP**bucket).columns
        products = library().code_products(rows.astype(np.float32), of_usual).max(axis=1)
        gaps.append((products / n2).min() - least)
    assert min(gaps) >= 0
    assert min(gaps) < 0.01


def test_blurred_codes_are_compared_only_where_they_may_count(place_markers, draw_markers, monkeypatch):
    """Without the bound, all quadrilaterals are compared with blurred codes, with the same result."""
    rng = np.random.default_rng(10)
    matrices, corners, size = grid(place_markers, 14.0, rng.uniform(-np.pi, np.pi, 50))
    image = draw_markers(matrices, range(50), size, rng, psf_px=1.0)
    quads = np.concatenate([corners, corners + rng.uniform(-4, 4, (50, 1, 2))])
    found, usual = [], decode._least_likeness
    for least in (usual, lambda *_: -1.0, lambda *_: 2.0):
        monkeypatch.setattr(decode, "_least_likeness", least)
        found.append(decode_quads(image, quads, "4X4_50", 0.6, -1.0))
    bounded, everywhere, nowhere = found
    np.testing.assert_array_equal(bounded.ids, everywhere.ids)
    np.testing.assert_array_equal(bounded.correlations, everywhere.correlations)
    assert (nowhere.correlations < bounded.correlations).any()
    bucket = int(decode._buckets(np.array(0.6 / (14.0 / 6))))
    assert np.mean(nowhere.correlations < usual("4X4_50", bucket)) > 0.1
