"""Log odds that a candidate shows a marker, against a reference fit and against what is no marker."""

import math

import cv2
import numpy as np
import pytest
from scipy.special import ndtr
from tests.helpers import pattern_reference
from tests.helpers.native_builds import builds

from skyherd.errors import InputError
from skyherd.markers.dictionary import border_cells, marker_cells
from skyherd.messages import Quality
from skyherd.vision import PhotometricDetector
from skyherd.vision.native.library import declared
from skyherd.vision.native.pattern_records import PARTS
from skyherd.vision.photometric import measure
from skyherd.vision.photometric.evidence import likelihood, pattern_fit, random_bits
from skyherd.vision.photometric.evidence import readings as readings_module
from skyherd.vision.photometric.evidence.likelihood import clear_log_odds, marker_odds, min_log_odds
from skyherd.vision.photometric.evidence.pattern_fit import fit_patterns
from skyherd.vision.photometric.evidence.readings import (
    Readings,
    cell_edges,
    exposed,
)
from skyherd.vision.photometric.likely import weigh
from skyherd.vision.search.decode import blurred_codes
from skyherd.vision.search.edges import fit_edges

CELL_PX, MARGIN_PX, BLUR_PX = 6, 30, 1.0


def card(cells: np.ndarray, *, white_cells: float = 1.0, ground: float = 120.0) -> np.ndarray:
    """An image of levels of cells (n, n) on a white card, whose zone is `white_cells` wide, on a ground."""
    side = len(cells) * CELL_PX
    image = np.full((side + 2 * MARGIN_PX,) * 2, ground)
    zone = round(white_cells * CELL_PX)
    image[MARGIN_PX - zone : MARGIN_PX + side + zone, MARGIN_PX - zone : MARGIN_PX + side + zone] = 200.0
    square = slice(MARGIN_PX, MARGIN_PX + side)
    image[square, square] = np.kron(np.where(cells, 200.0, 30.0), np.ones((CELL_PX, CELL_PX)))
    return np.asarray(cv2.GaussianBlur(image, (0, 0), BLUR_PX))


def corners(n: int, turn: int = 0) -> np.ndarray:
    """Corners (1, 4, 2) of the square of n cells, beginning with corner `turn`."""
    low, high = MARGIN_PX - 0.5, MARGIN_PX + n * CELL_PX - 0.5
    return np.roll(np.array([[[low, low], [high, low], [high, high], [low, high]]]), -turn, axis=1)


def noisy(levels: np.ndarray, seed: int, std: float = 2.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(levels + rng.normal(0, std, levels.shape)), 0, 255).astype(np.uint8)


def flipped(cells: np.ndarray, *bits: tuple[int, int]) -> np.ndarray:
    cells = cells.copy()
    for row, column in bits:
        cells[row, column] ^= True
    return cells


def test_overexposed_edge_seems_to_end_at_half_the_contrast() -> None:
    blur_cells = 0.4
    edges = cell_edges(6, 6, blur_cells, clips=True)
    white = ndtr((edges[0] - 0.0) / blur_cells)  # at 0, of white left of the first edge
    assert exposed(np.array([white]), True)[0] == pytest.approx(0.5)
    assert edges[-1] - 6 == pytest.approx(-edges[0])
    np.testing.assert_array_equal(cell_edges(6, 6, blur_cells, clips=False), np.arange(7))


def test_thresholds_are_below_the_most_that_bits_can_show() -> None:
    most = 16 * math.log(2 * 0.98) - math.log(4 * 50) - math.log(likelihood.BITS_ODDS)
    assert likelihood.most_log_odds("4X4_50") == pytest.approx(most) == pytest.approx(8.4646, abs=1e-3)
    assert clear_log_odds("4X4_50") == pytest.approx(most - likelihood.MAX_DOUBT)
    assert clear_log_odds("4X4_250") == pytest.approx(clear_log_odds("4X4_50") - math.log(5))
    assert clear_log_odds("APRILTAG_36h11") == likelihood.CLEAR_LOG_ODDS
    assert min_log_odds("APRILTAG_36h11") == likelihood.MIN_LOG_ODDS
    assert min_log_odds("4X4_50") == clear_log_odds("4X4_50")


def test_further_evidence_adds_log_odds() -> None:
    """Not for dictionaries whose markers cannot have the odds of the constant."""
    robust, like = likelihood.ROBUST_LOG_ODDS, likelihood.LIKE_LOG_ODDS
    for dictionary in ("4X4_50", "APRILTAG_36h11"):
        some = min_log_odds(dictionary, robust=np.array([True, False]), has_like=np.array([False, True]))
        np.testing.assert_allclose(some, likelihood.MIN_LOG_ODDS - np.array([robust, like]))
        assert least_log_odds(dictionary) == pytest.approx(likelihood.MIN_LOG_ODDS - robust - like)
    assert least_log_odds("4X4_1000") == min_log_odds("4X4_1000") == clear_log_odds("4X4_1000")


def least_log_odds(dictionary: str) -> float:
    """The log odds of a candidate with all further evidence."""
    return float(min_log_odds(dictionary, robust=True, has_like=True))


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize(("dictionary", "marker"), [("4X4_50", 8), ("APRILTAG_36h11", 301)])
def test_marker_is_read_from_any_corner(dictionary, marker, turn) -> None:
    cells = marker_cells(dictionary, marker)
    odds = marker_odds(noisy(card(cells), 1), corners(len(cells), turn), dictionary)
    assert odds.ids.tolist() == [marker] and (odds.turns[0] + turn) % 4 == 0
    assert odds.log_odds[0] > clear_log_odds(dictionary)


@pytest.mark.parametrize("seed", range(5))
def test_one_wrong_bit_of_16_is_refused(seed) -> None:
    """The negative control: the same square with a bit that no marker of the dictionary has."""
    rng = np.random.default_rng(seed)
    cells = marker_cells("4X4_50", int(rng.integers(50)))
    wrong = flipped(cells, tuple(rng.integers(1, 5, 2)))
    odds = marker_odds(noisy(card(wrong), seed), corners(6), "4X4_50")
    assert odds.log_odds[0] < least_log_odds("4X4_50")


def test_two_wrong_bits_of_36_are_accepted_and_six_refused() -> None:
    cells = marker_cells("APRILTAG_36h11", 17)
    bits = [(1, 2), (3, 6), (5, 1), (6, 6), (2, 4), (4, 3)]
    none, two, six = (
        marker_odds(noisy(card(flipped(cells, *bits[:count])), 3), corners(8), "APRILTAG_36h11").log_odds[0]
        for count in (0, 2, 6)
    )
    assert min(none, two) > clear_log_odds("APRILTAG_36h11") and six < least_log_odds("APRILTAG_36h11")


@pytest.mark.parametrize("spot_cells", [(3.0, 5.0), (2.2, 5.4), (1.8, 6.6)])
def test_bits_under_glare_count_neither_for_nor_against(spot_cells, monkeypatch) -> None:
    """A spot of light saturates several black cells. The control takes them for white ones."""
    levels = card(marker_cells("APRILTAG_36h11", 40))
    rows, columns = np.indices(levels.shape)
    middle = MARGIN_PX + np.array(spot_cells) * CELL_PX
    distances_px = np.hypot(rows - middle[0], columns - middle[1])
    image = noisy(levels + 400 * np.exp(-((distances_px / 6.0) ** 2) / 2), 3)
    odds = marker_odds(image, corners(8), "APRILTAG_36h11")
    assert odds.ids[0] == 40 and odds.log_odds[0] > clear_log_odds("APRILTAG_36h11")
    monkeypatch.setattr(readings_module, "SATURATED", 300.0)
    refused = marker_odds(image, corners(8), "APRILTAG_36h11")
    assert refused.log_odds[0] < least_log_odds("APRILTAG_36h11")


def test_log_odds_do_not_depend_on_light() -> None:
    """Levels times 0.4 plus 60 leave the log odds, apart from the rounding of grey levels."""
    levels = card(marker_cells("4X4_50", 3))
    bright, pale = (
        marker_odds(noisy(one, 1, 0.5), corners(6), "4X4_50") for one in (levels, 60 + 0.4 * levels)
    )
    assert pale.log_odds[0] == pytest.approx(bright.log_odds[0], abs=0.05)
    assert pale.contrasts[0] == pytest.approx(0.4 * bright.contrasts[0], rel=0.02)


@pytest.mark.parametrize("white_cells", [0.25, 0.4, 1.0])
@pytest.mark.parametrize("ground", [40.0, 200.0])
def test_narrow_cards_are_read_on_any_ground(white_cells, ground) -> None:
    image = noisy(card(marker_cells("4X4_50", 11), white_cells=white_cells, ground=ground), 2)
    odds = marker_odds(image, corners(6), "4X4_50")
    assert odds.ids.tolist() == [11] and odds.log_odds[0] > clear_log_odds("4X4_50")


@pytest.mark.parametrize("ground", [70.0, 100.0, 150.0])
def test_markers_cut_out_along_their_black_are_read(ground, monkeypatch) -> None:
    """On grey ground; not marker 17, a light rectangle. Without a card of no width, a control, fewer are."""

    def read() -> int:
        found = 0
        for marker in set(range(50)) - {17}:
            image = noisy(card(marker_cells("4X4_50", marker), white_cells=0, ground=ground), 3, 1.0)
            odds = marker_odds(image, corners(6), "4X4_50")
            found += int(odds.ids[0] == marker and odds.log_odds[0] > clear_log_odds("4X4_50"))
        return found

    assert read() >= 48
    monkeypatch.setattr(pattern_fit, "CARD_WIDTHS_CELLS", pattern_fit.CARD_WIDTHS_CELLS[1:])
    assert read() < 48


@pytest.mark.parametrize("marker", [40, 270, 471])
def test_bits_within_a_wider_black_border_are_refused(marker) -> None:
    """The bits alone are those of the marker. A narrow card or dark grey ground shows its outline."""
    dictionary, cells = "APRILTAG_36h11", marker_cells("APRILTAG_36h11", marker)
    bare, narrow = (noisy(card(cells, white_cells=white, ground=30.0), 2) for white in (0.0, 0.25))
    grey = noisy(card(cells, white_cells=0.0, ground=64.0), 2)
    assert marker_odds(bare, corners(8), dictionary).log_odds[0] > clear_log_odds(dictionary)
    bare_odds, *others = (
        weigh(image, dictionary, fit_edges(image, corners(8), 8), corners(8)).log_odds[0]
        for image in (bare, narrow, grey)
    )
    assert bare_odds == -np.inf
    assert min(others) > clear_log_odds(dictionary)


@pytest.mark.parametrize("box", [(1.6, 3.3, 1.5, 4.2), (2.2, 4.4, 1.7, 2.9), (1.2, 4.8, 1.3, 4.9)])
def test_light_rectangles_in_dark_squares_are_refused(box) -> None:
    top, bottom, left, right = (MARGIN_PX + round(edge * CELL_PX) for edge in box)
    levels = card(np.zeros((6, 6), dtype=bool))
    levels[top:bottom, left:right] = 200.0
    odds = marker_odds(noisy(cv2.GaussianBlur(levels, (0, 0), BLUR_PX), 4), corners(6), "4X4_50")
    assert odds.log_odds[0] < least_log_odds("4X4_50")


@pytest.mark.parametrize("marker", range(0, 50, 3))
def test_overexposed_markers_are_read_and_wrong_bits_refused(marker) -> None:
    """Three times too much light clips white: edges move by one standard deviation of the blur, 1 px here."""
    square = corners(6) + np.array([[[1, 1], [-1, 1], [-1, -1], [1, -1]]])
    cells = marker_cells("4X4_50", marker)
    wrong = flipped(cells, tuple(np.random.default_rng(marker).integers(1, 5, 2)))
    right, other = (
        marker_odds(noisy(3 * card(bits), marker), square, "4X4_50").log_odds[0] for bits in (cells, wrong)
    )
    assert right > clear_log_odds("4X4_50") and other < least_log_odds("4X4_50")


def fine(levels: np.ndarray) -> np.ndarray:
    """Levels four times as fine, without interpolation."""
    return np.repeat(np.repeat(levels, 4, axis=0), 4, axis=1)


@pytest.mark.parametrize(
    ("box", "blur_px"),
    [
        ((0.93, 3.47, 2.06, 3.76), 1.55),
        ((1.11, 3.19, 2.09, 4.23), 1.66),
        ((0.94, 3.27, 2.0, 3.68), 2.49),
    ],
)
def test_light_rectangle_like_marker_17_is_refused(box, blur_px) -> None:
    """Two cells by two are white in 17. All other hypotheses leave these rectangles above the threshold."""
    levels = fine(card(np.zeros((6, 6), dtype=bool)))
    top, bottom, left, right = (round(4 * (MARGIN_PX + edge * CELL_PX)) for edge in box)
    levels[top:bottom, left:right] = 200.0
    small = cv2.resize(levels, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    odds = marker_odds(noisy(cv2.GaussianBlur(small, (0, 0), blur_px), 1), corners(6), "4X4_50")
    assert odds.ids[0] == 17 and odds.log_odds[0] < least_log_odds("4X4_50")
    assert odds.against[0, [0, 1, 3]].min() > clear_log_odds("4X4_50") - 0.5


def light_rectangle(
    box: tuple[float, ...], margin_cells: float, ground: float, white: float, light: float, blur_px: float
) -> np.ndarray:
    """An image of a dark square on a white card, with a light box (top, bottom, left, right), in cells."""
    levels = fine(np.full_like(card(np.zeros((6, 6), dtype=bool)), ground))
    card_box = (-margin_cells, 6 + margin_cells) * 2
    for edges, level in ((card_box, white), ((0, 6, 0, 6), 30), (box, light)):
        top, bottom, left, right = (round(4 * (MARGIN_PX + edge * CELL_PX)) for edge in edges)
        levels[top:bottom, left:right] = level
    small = cv2.resize(levels, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    return noisy(cv2.GaussianBlur(small, (0, 0), blur_px), 1)


@pytest.mark.parametrize(
    ("box", "margin_cells", "ground", "light", "blur_px"),
    [
        ((0.83, 3.48, 1.98, 3.85), 0.59, 62, 234, 0.89),
        ((0.78, 3.41, 1.98, 3.87), 0.76, 107, 194, 1.72),
        ((0.5, 3.0, 2.0, 4.0), 0.75, 120, 240, 1.2),
        ((0.5, 3.0, 2.0, 4.0), 0.0, 120, 240, 1.2),
    ],
)
def test_light_rectangle_on_a_narrow_card_is_refused(box, margin_cells, ground, light, blur_px) -> None:
    """The ground beyond the card does not count against the rectangle alone."""
    image = light_rectangle(box, margin_cells, ground, 240, light, blur_px)
    odds = marker_odds(image, corners(6), "4X4_50")
    assert odds.ids[0] == 17 and odds.log_odds[0] < least_log_odds("4X4_50")
    assert odds.against[0, [0, 1, 3]].min() > clear_log_odds("4X4_50") - 0.5


@pytest.mark.parametrize(
    ("box", "light", "blur_px"), [((0.67, 3.27, 2.06, 4.14), 191, 0.6), ((0.84, 3.32, 1.9, 3.94), 188, 0.56)]
)
def test_what_is_rather_no_marker_is_not_refitted(box, light, blur_px, monkeypatch) -> None:
    """A refit to the visible pixels would take a part of the rectangle for a cover, and verify marker 17."""
    image = light_rectangle(box, 1.0, 120, 200, light, blur_px)
    assert marker_odds(image, corners(6), "4X4_50").log_odds[0] < 0
    assert PhotometricDetector("4X4_50", following=False).detect(image).ids.size == 0
    monkeypatch.setattr(measure, "MIN_REFIT_LOG_ODDS", -2.0)
    assert PhotometricDetector("4X4_50", following=False).detect(image).ids.tolist() == [17]


@pytest.mark.parametrize(("marker", "bits"), [(3, 6), (9, 7), (19, 5), (5, 8)])
def test_bits_of_a_marker_on_another_grid_are_refused(marker, bits) -> None:
    """Other codes and bits by chance leave them above the threshold."""
    nearest = ((np.arange(bits + 2) + 0.5) / (bits + 2) * 6).astype(int)
    cells = marker_cells("4X4_50", marker)[np.ix_(nearest, nearest)]
    cells[[0, -1]] = cells[:, [0, -1]] = False
    square = np.kron(np.where(cells, 200.0, 30.0), np.ones((36, 36)))
    levels = card(np.zeros((6, 6), dtype=bool))
    inside = slice(MARGIN_PX, MARGIN_PX + 6 * CELL_PX)
    levels[inside, inside] = cv2.resize(square, (6 * CELL_PX,) * 2, interpolation=cv2.INTER_AREA)
    odds = marker_odds(noisy(cv2.GaussianBlur(levels, (0, 0), BLUR_PX), 4), corners(6), "4X4_50")
    assert odds.ids[0] == marker and odds.log_odds[0] < 0
    assert odds.against[0, :2].min() > clear_log_odds("4X4_50")


def test_blurred_bits_count_less_than_sharp_ones() -> None:
    """Beyond half a cell of blur the independent bits fall with its square, here to 0.48 of 36."""
    cells = marker_cells("APRILTAG_36h11", 5)
    sharp = card(cells)
    odds = marker_odds(
        noisy(cv2.GaussianBlur(sharp, (0, 0), 0.72 * CELL_PX), 1), corners(8), "APRILTAG_36h11"
    )
    bits = (0.5 / 0.72) ** 2 * 36 * math.log(1.96)
    most = bits - math.log(4 * 587) - math.log(likelihood.BITS_ODDS)
    assert odds.ids[0] == 5 and odds.against[0, 1] == pytest.approx(most, abs=0.5)


@pytest.mark.parametrize("sigma_cells", [0.1, 0.36, 0.72])
def test_no_log_odds_exceed_those_that_the_blur_allows(sigma_cells) -> None:
    """Markers and random bits; a sharp marker comes near its ceiling, so that it is no empty bound."""
    rng = np.random.default_rng(11)
    cells = [marker_cells("APRILTAG_36h11", number) for number in (5, 301)]
    cells += [np.pad(rng.random((6, 6)) < 0.5, 1) for _ in range(6)]
    shown = [cv2.GaussianBlur(card(one), (0, 0), sigma_cells * CELL_PX) for one in cells]
    odds = [marker_odds(noisy(one, seed), corners(8), "APRILTAG_36h11") for seed, one in enumerate(shown)]
    log_odds = np.array([one.log_odds[0] for one in odds])
    ceilings = np.array([one.ceilings[0] for one in odds])
    assert (log_odds <= ceilings + 1e-9).all()
    if sigma_cells < random_bits.RESOLVED_CELLS:
        assert (log_odds[:2] > ceilings[:2] - 0.5).all()


def test_lines_are_not_looked_for_where_blur_leaves_no_hope(monkeypatch) -> None:
    """A marker of 16 bits so blurred that it could not be accepted whatever lies on it."""
    levels = cv2.GaussianBlur(card(marker_cells("4X4_50", 7)), (0, 0), 0.72 * CELL_PX)
    given, asked = (noisy(levels, 1), corners(6), "4X4_50"), []
    without_line = likelihood.without_line
    monkeypatch.setattr(likelihood, "without_line", lambda *of: asked.append(1) or without_line(*of))
    odds = marker_odds(*given)
    assert odds.ids[0] == 7 and odds.ceilings[0] < min_log_odds("4X4_50", robust=True)
    assert not asked
    monkeypatch.setattr(likelihood, "ROBUST_LOG_ODDS", np.inf)
    marker_odds(*given)
    assert asked, "the negative control"


@pytest.mark.parametrize(("name", "column"), [("BITS_ODDS", 1), ("RECTANGLES_ODDS", 2), ("GRIDS_ODDS", 3)])
def test_prior_odds_count_once_against_a_marker(name, column, monkeypatch) -> None:
    """With prior odds greater by e, the log odds against that hypothesis alone are smaller by 1."""
    given = noisy(card(marker_cells("4X4_50", 11)), 1), corners(6), "4X4_50"
    before, prior = marker_odds(*given).against[0], getattr(likelihood, name)
    reference = before - np.eye(4)[column]
    monkeypatch.setattr(likelihood, name, math.e * prior)
    assert np.isfinite(before).all()
    np.testing.assert_allclose(marker_odds(*given).against[0], reference, atol=1e-9)


def test_candidates_are_weighed_alike_in_parts(monkeypatch) -> None:
    image = noisy(card(marker_cells("APRILTAG_36h11", 301)), 1)
    places = np.concatenate([corners(8), corners(8) + 1.5, corners(8, 2), corners(8) - 1])
    whole = marker_odds(image, places, "APRILTAG_36h11")
    monkeypatch.setattr(likelihood, "CANDIDATES_AT_ONCE", 3)
    parts = marker_odds(image, places, "APRILTAG_36h11")
    assert np.isfinite(whole.log_odds).sum() > 1
    np.testing.assert_allclose(parts.log_odds, whole.log_odds, rtol=1e-6)
    np.testing.assert_array_equal(parts.turns, whole.turns)


def test_shaded_half_of_a_marker_is_not_taken_for_black() -> None:
    """Id 8 with the light of one half times 0.25 resembles id 28, whose other half is black."""
    levels = card(marker_cells("4X4_50", 8))
    rows, columns = np.indices(levels.shape)
    middle = levels.shape[0] / 2
    for angle in np.linspace(0, 2 * np.pi, 12, endpoint=False):
        beyond = np.cos(angle) * (columns - middle) + np.sin(angle) * (rows - middle) > 1.5
        odds = marker_odds(noisy(np.where(beyond, 0.25 * levels, levels), 5), corners(6), "4X4_50")
        assert odds.ids[0] == 8 or odds.log_odds[0] < least_log_odds("4X4_50")


def random_readings(n: int, count: int, each: int, rng: np.random.Generator) -> tuple[Readings, np.ndarray]:
    """Readings of patterns under changing light, with outliers and glare, and `each` patterns for each."""
    side = PARTS * (n + 2)
    cells = rng.integers(0, 2, (count, each, n + 2, n + 2)).astype(float)
    white = cv2.blur(np.kron(cells, np.ones((PARTS, PARTS))).reshape(-1, side, side).T, (3, 3)).T
    white = np.ascontiguousarray(white).reshape(count, each, -1)
    light = np.linspace(0.7, 1.3, side)[:, None] * np.linspace(0.9, 1.2, side)
    levels = 40 + rng.uniform(2, 120, (count, 1)) * white[:, 0] * light.ravel()
    levels += rng.normal(0, 5, levels.shape)
    levels[rng.random(levels.shape) < 0.05] = 255
    seen = (rng.random(levels.shape) > 0.1).astype(float)
    weights, scales, ranges = rng.uniform(0.1, 0.4, count), rng.uniform(50, 200, count), np.full(count, 90.0)
    return Readings(np.clip(np.rint(levels), 0, 255), weights, scales, ranges, seen), white


@pytest.mark.parametrize("n", [3, 6, 8, 20])
@pytest.mark.parametrize("grounds", [0, 1, 4])
def test_fits_of_patterns_agree_with_the_reference(n: int, grounds: int) -> None:
    """Single precision for the parts and double for the sums, against double precision."""
    rng = np.random.default_rng([n, grounds])
    readings, white = random_readings(n, 4, 5, rng)
    ground = rng.random((grounds, white.shape[2])) if grounds else None
    for any_contrast in (False, True):
        fitted = fit_patterns(readings, white, ground, any_contrast=any_contrast)
        expected = pattern_reference.fit_patterns(readings, white, ground, any_contrast=any_contrast)
        assert np.array_equal(np.isfinite(fitted.logs), np.isfinite(expected.logs))
        assert np.isfinite(fitted.logs[:, 0]).any()
        for name in ("logs", "levels", "stds", "outlier_shares"):
            np.testing.assert_allclose(getattr(fitted, name), getattr(expected, name), rtol=2e-5, atol=2e-4)


def test_builds_fit_patterns_with_equal_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    readings, white = random_readings(8, 3, 4, np.random.default_rng(1))
    ground, fitted = np.linspace(0, 1, white.shape[2])[None], []
    for build in builds("vision", declared).values():
        monkeypatch.setattr(pattern_fit, "library", lambda build=build: build)
        fits = fit_patterns(readings, white, ground)
        fitted.append([getattr(fits, name).tobytes() for name in vars(fits)])
    assert all(one == fitted[0] for one in fitted)


def test_fit_of_patterns_rejects_other_shapes() -> None:
    readings, white = random_readings(6, 2, 3, np.random.default_rng(2))
    with pytest.raises(InputError, match="patterns"):
        fit_patterns(readings, white[..., 1:])
    with pytest.raises(InputError, match="out of range"):
        fit_patterns(readings, white, np.zeros((3, white.shape[2])))


def spoilt(kind: str, seed: int) -> np.ndarray:
    """A marker of 36h11 under salt or glare."""
    rng = np.random.default_rng(seed)
    image = noisy(card(marker_cells("APRILTAG_36h11", 40)), seed).astype(float)
    if kind == "salt":
        image[rng.random(image.shape) < 0.08] = 255
    else:
        rows, columns = np.indices(image.shape)
        image += 400 * np.exp(-((rows - 48) ** 2 + (columns - 60) ** 2) / (2 * 3.0**2))
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("kind", ["salt", "glare"])
def test_spoilt_marker_is_measured_with_an_honest_quality(kind) -> None:
    """Found, not as a photometric one, with errors that its covariance allows at 4 sigma."""
    for seed in range(3):
        seen = PhotometricDetector("APRILTAG_36h11", following=False).detect(spoilt(kind, seed))
        assert seen.ids.tolist() == [40] and seen.qualities[0] < Quality.PHOTOMETRIC
        middle = MARGIN_PX + 4 * CELL_PX - 0.5
        off = seen.centers_px[0] - middle
        assert off @ np.linalg.solve(seen.covariances[0, :2, :2], off) < 2 * 4**2


def glaring(marker: int, seed: int, spot_px: float) -> np.ndarray:
    """A marker of 36h11 under a round spot of light, whose brightness has the given standard deviation."""
    rng = np.random.default_rng(seed)
    levels = card(marker_cells("APRILTAG_36h11", marker))
    row, column = MARGIN_PX + rng.uniform(0.2, 0.8, 2) * 8 * CELL_PX
    rows, columns = np.indices(levels.shape)
    distances_px = np.hypot(rows - row, columns - column)
    return noisy(levels + 400 * np.exp(-((distances_px / spot_px) ** 2) / 2), seed)


@pytest.mark.parametrize(
    ("marker", "seed", "spot_px", "quality"),
    [
        (301, 2, 5.0, Quality.ROBUST),  # leaves 0.44 of the bits
        (40, 3, 6.5, Quality.ROBUST),  # 0.47
        (40, 11, 6.0, Quality.CORNERS),  # 0.53
        (301, 2, 6.0, Quality.CORNERS),  # 0.56
    ],
)
def test_fit_that_explains_half_of_the_bits_measures_a_marker(marker, seed, spot_px, quality) -> None:
    seen = PhotometricDetector("APRILTAG_36h11", following=False).detect(glaring(marker, seed, spot_px))
    assert seen.ids.tolist() == [marker] and seen.qualities.tolist() == [quality]
    off_px = np.linalg.norm(seen.centers_px[0] - (MARGIN_PX + 4 * CELL_PX - 0.5))
    assert off_px < (0.02 if quality == Quality.ROBUST else 0.06)


def test_candidates_among_those_like_no_code_keep_their_odds() -> None:
    """Candidates unlike all codes are left out of the comparison; the others keep their rows."""
    cells = marker_cells("APRILTAG_36h11", 301)
    image = noisy(card(cells), 1)
    ground = corners(8) / 8  # a corner of the image, with noise alone
    turned = corners(8, 3)
    together = marker_odds(image, np.concatenate([ground, corners(8), ground + 1, turned]), "APRILTAG_36h11")
    alone = [marker_odds(image, one, "APRILTAG_36h11") for one in (corners(8), turned)]
    assert together.log_odds[0] == together.log_odds[2] == -np.inf
    assert together.ids[[1, 3]].tolist() == [301, 301] and together.turns[1] != together.turns[3]
    np.testing.assert_allclose(together.log_odds[[1, 3]], [one.log_odds[0] for one in alone])


def test_correlation_is_that_of_cells_with_the_nearest_code() -> None:
    cells = flipped(marker_cells("APRILTAG_36h11", 301), (1, 2))
    readings = Readings.read(noisy(card(cells), 1), corners(8), 8)
    codes, correlations = readings_module.nearest_codes(readings, "APRILTAG_36h11")
    columns = [blurred_codes("APRILTAG_36h11", blur).columns.columns for blur in (0.2, 0.5)]
    patterns = [one[:, codes[0, 0]] for one in columns]
    seen = readings.cells[0, 1:-1, 1:-1].ravel()
    assert codes[0, 0] == 4 * 301
    assert correlations[0] == pytest.approx(max(np.corrcoef(seen, one)[0, 1] for one in patterns), abs=1e-4)


@pytest.mark.parametrize("clips", [False, True])
def test_codes_are_compared_as_if_they_were_drawn(clips) -> None:
    """Each code under each blur drawn from its edges; the blur of the greatest correlation is chosen."""
    rng, n = np.random.default_rng(5), 6
    readings = Readings.read(noisy(card(marker_cells("4X4_50", 7)), 2, std=20.0), corners(n), n)
    codes = rng.integers(0, 200, (1, 6))
    codes[0, 0] = 4 * 7
    blurs, alike, drawn = readings_module._drawn_most_alike(readings, codes, "4X4_50", clips=clips)
    black = readings_module.black_cells("4X4_50")
    for k, code in enumerate(codes[0]):
        correlations, whites = [], []
        for along, down in readings_module.BLURS_CELLS:
            shares = (readings_module.cell_shares(n, n, blur, clips=clips) for blur in (down, along))
            rows, columns = shares
            whites.append((1 - rows @ black[code] @ columns.T).ravel())
            correlations.append(np.corrcoef(exposed(whites[-1], clips), readings.levels[0])[0, 1])
        assert blurs[0, k] == np.argmax(correlations)
        per_part = np.sqrt(readings.levels.shape[1])
        np.testing.assert_allclose(alike[0, k] / per_part, max(correlations), atol=1e-5)
        np.testing.assert_allclose(drawn[0, k], whites[blurs[0, k]], atol=1e-5)


@pytest.mark.parametrize("turn_deg", [0, 45])
@pytest.mark.parametrize("dictionary", ["APRILTAG_36h11", "APRILTAG_36h11@2"])
def test_a_marker_with_bits_beyond_the_image_has_no_odds(dictionary, turn_deg, monkeypatch) -> None:
    """The border may be cut off; the bits of a marker must lie in the image."""
    cells = marker_cells(dictionary, 8)
    n, border = len(cells), border_cells(dictionary)
    middle = MARGIN_PX + n * CELL_PX / 2 - 0.5
    turn = cv2.getRotationMatrix2D((middle, middle), turn_deg, 1.0)
    image = cv2.warpAffine(card(cells), turn, None, borderMode=cv2.BORDER_REPLICATE)
    square = corners(n) @ turn[:, :2].T + turn[:, 2]
    first = (middle + (1 - 2 * border / n) * (square - middle))[..., 0].min() + 0.5  # edge of the bits
    shown = [
        likelihood._bits_in_image(image[:, left:], square - [left, 0], dictionary)[0]
        for left in (int(first), int(first) + 1)
    ]
    assert shown == [True, False]
    given = noisy(image[:, int(first) + 1 :], 1), square - [int(first) + 1, 0], dictionary
    assert marker_odds(*given).log_odds[0] == -np.inf == marker_odds(*given).against.min()
    monkeypatch.setattr(likelihood, "_bits_in_image", lambda *of: np.array([True]))
    assert marker_odds(*given).against.min() > -np.inf  # the negative control


def test_candidates_beyond_the_image_leave_the_others_odds(monkeypatch) -> None:
    """Of two equal candidates the one that counts as cut has no odds; the other keeps its row."""
    image = noisy(card(marker_cells("APRILTAG_36h11", 301)), 1)
    both = np.concatenate([corners(8), corners(8, 3)])
    alone = marker_odds(image, corners(8, 3), "APRILTAG_36h11")
    monkeypatch.setattr(likelihood, "_bits_in_image", lambda *of: np.array([False, True]))
    odds = marker_odds(image, both, "APRILTAG_36h11")
    assert odds.log_odds[0] == -np.inf and odds.log_odds[1] == pytest.approx(alone.log_odds[0])
    assert odds.turns[1] == alone.turns[0] and odds.ids[1] == 301


def robots_from_above(margin_cells: float, side_px: float, *, bolts: bool = False, body: float = 25.0):
    """Return an image of twelve markers on dark robots: cards with a margin, perhaps held by bright bolts."""
    rng, zoom, cell = np.random.default_rng(4), 4, 20
    image = np.full((240 * zoom, 320 * zoom), 110.0, dtype=np.float32)
    for marker in range(12):
        cells = marker_cells("4X4_50", marker).astype(np.float32)
        n, pad = len(cells), round(margin_cells * cell)
        card = np.pad(np.kron(cells, np.ones((cell, cell), np.float32)), pad, constant_values=1.0)
        robot = np.pad(30 + 190 * card, 2 * cell, constant_values=body)
        if bolts:
            low, high = 2 * cell + pad + cell // 2, len(robot) - 1 - 2 * cell - pad - cell // 2
            for u, v in ((low, low), (low, high), (high, low), (high, high)):
                cv2.circle(robot, (u, v), round(0.45 * cell), 225.0, cv2.FILLED)
        column, row = marker % 4, marker // 4
        center = zoom * np.array([40 + 80 * column, 40 + 80 * row]) + rng.uniform(-8, 8, 2)
        to_image = cv2.getRotationMatrix2D((0, 0), rng.uniform(0, 360), zoom * side_px / (n * cell))
        to_image[:, 2] = center - to_image[:, :2] @ np.full(2, (len(robot) - 1) / 2)
        how = {"flags": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_TRANSPARENT}
        cv2.warpAffine(robot.astype(np.float32), to_image, image.shape[::-1], dst=image, **how)
    small = cv2.GaussianBlur(cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    return np.clip(np.rint(small + rng.normal(0, 2, small.shape)), 0, 255).astype(np.uint8)


def found_on_robots(**how) -> list[int]:
    return PhotometricDetector("4X4_50", following=False).detect(robots_from_above(**how)).ids.tolist()


def test_narrow_cards_on_dark_robots_are_found(monkeypatch) -> None:
    """The margin is a fifth of a cell, 0.7 px; wide cards explain nothing there."""
    assert len(found_on_robots(margin_cells=0.2, side_px=22.0)) >= 11
    monkeypatch.setattr(likelihood, "CLEAR_CELL_CORRELATION", 2.0)
    assert len(found_on_robots(margin_cells=0.2, side_px=22.0)) < 6


def test_bright_bolts_in_the_corners_hide_no_marker() -> None:
    assert len(found_on_robots(margin_cells=0.6, side_px=40.0, bolts=True)) >= 11
