"""Readings under a shadow's edge: the edge and its factor are found, and no clutter becomes a marker."""

import cv2
import numpy as np
import pytest

from skyherd.markers.dictionary import marker_cells
from skyherd.vision import PhotometricDetector
from skyherd.vision.photometric.evidence import likelihood
from skyherd.vision.photometric.evidence.likelihood import clear_log_odds, marker_odds, min_log_odds
from skyherd.vision.photometric.evidence.readings import Readings
from skyherd.vision.photometric.evidence.shade import without_shade

CELL_PX, MARGIN_PX = 6, 30
DICTIONARY = "4X4_50"
ONE = np.ones(1, dtype=bool)


def corners(n: int) -> np.ndarray:
    """Corners (1, 4, 2) of the square of n cells."""
    low, high = MARGIN_PX - 0.5, MARGIN_PX + n * CELL_PX - 0.5
    return np.array([[[low, low], [high, low], [high, high], [low, high]]])


def card(cells: np.ndarray) -> np.ndarray:
    """Grey levels of cells (n, n) on white, blurred by 0.6 px."""
    levels = np.pad(np.kron(np.where(cells, 200.0, 30.0), np.ones((CELL_PX,) * 2)), 6, constant_values=200.0)
    levels = np.pad(levels, MARGIN_PX - 6, constant_values=120.0)
    return np.asarray(cv2.GaussianBlur(levels, (0, 0), 0.6))


def shaded(levels: np.ndarray, factor: float, angle: float, offset_px: float, seed: int = 1) -> np.ndarray:
    """Return an image with the light beyond a line times a factor, and noise of 2 grey levels."""
    rows, columns = np.indices(levels.shape) - (levels.shape[0] - 1) / 2
    beyond = np.cos(angle) * columns + np.sin(angle) * rows > offset_px
    noise = np.random.default_rng(seed).normal(0, 2, levels.shape)
    return np.clip(np.rint(np.where(beyond, factor * levels, levels) + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("angle", np.linspace(0.1, 6.1, 7))
@pytest.mark.parametrize("factor", [0.25, 0.6])
def test_shaded_side_gets_the_light_of_the_other(angle: float, factor: float) -> None:
    """The readings are those without a shadow, apart from the parts on its edge."""
    levels = card(marker_cells(DICTIONARY, 9))
    bare, under = (Readings.read(shaded(levels, k, angle, 3.0), corners(6), 6) for k in (1.0, factor))
    assert np.mean(np.abs(under.levels - bare.levels) > 20) > 0.25
    lit = without_shade(under, DICTIONARY)[0].levels
    assert np.mean(np.abs(lit - bare.levels) > 20) < 0.08
    assert np.median(np.abs(lit - bare.levels)) < 4


def test_even_light_is_left_as_it_is() -> None:
    """Also under a gradient of light, which is no edge."""
    levels = card(marker_cells(DICTIONARY, 9))
    even = Readings.read(shaded(levels, 1.0, 0.0, 0.0), corners(6), 6)
    np.testing.assert_array_equal(without_shade(even, DICTIONARY)[0].levels, even.levels)
    tilted = Readings.read(shaded(levels * np.linspace(0.95, 1.05, len(levels)), 1.0, 0, 0), corners(6), 6)
    np.testing.assert_array_equal(without_shade(tilted, DICTIONARY)[0].levels, tilted.levels)


@pytest.mark.parametrize("edges", [0, 2])
def test_markers_under_a_shadow_have_the_odds_of_markers(edges: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Seven eighths of 32 those of clear ones, none another id; without the search, fewer than four."""
    monkeypatch.setattr(likelihood, "MAX_SHADOW_EDGES", edges)
    clear = 0
    for number, marker in ((0, 2), (1, 11), (3, 23), (4, 40)):
        levels = card(marker_cells(DICTIONARY, marker))
        for turn in range(8):
            image = shaded(levels, 0.3, 0.2 + turn * np.pi / 4, 2.0 * number - 4)
            odds = marker_odds(image, corners(6), DICTIONARY)
            assert (
                odds.log_odds[0] < min_log_odds(DICTIONARY, robust=True, has_like=True)
                or odds.ids[0] == marker
            )
            clear += bool(odds.log_odds[0] >= clear_log_odds(DICTIONARY))
    assert clear >= 28 if edges else clear < 4


def test_edges_count_only_where_they_raise_the_odds(monkeypatch: pytest.MonkeyPatch) -> None:
    """A doubtful marker keeps its odds if what is left without the edges is noise."""
    rng = np.random.default_rng(8)
    image = shaded(card(marker_cells(DICTIONARY, 11)), 0.3, 0.2, 4.0)
    monkeypatch.setattr(likelihood, "MAX_SHADOW_EDGES", 0)
    before = marker_odds(image, corners(6), DICTIONARY)
    assert likelihood._is_hopeful(before, likelihood.SHADED_LOG_ODDS)[0]
    assert before.log_odds[0] < clear_log_odds(DICTIONARY)
    monkeypatch.setattr(likelihood, "MAX_SHADOW_EDGES", 2)
    noise = rng.uniform(0, 255, (1, 576))
    monkeypatch.setattr(likelihood, "without_shade", lambda readings, _: (readings.with_levels(noise), ONE))
    after = marker_odds(image, corners(6), DICTIONARY)
    assert (after.ids, after.log_odds) == (before.ids, before.log_odds)


def test_a_shadow_makes_no_marker_of_other_bits() -> None:
    """Random bits two bits from any marker at least, under a shadow, and markers with a flipped half."""
    rng = np.random.default_rng(4)
    known = np.stack([marker_cells(DICTIONARY, one)[1:-1, 1:-1] for one in range(50)])
    known = np.concatenate([np.rot90(known, turn, (1, 2)) for turn in range(4)])
    tried = 0
    while tried < 60:
        cells = np.zeros((6, 6), dtype=bool)
        cells[1:-1, 1:-1] = rng.integers(0, 2, (4, 4))
        if tried % 3 == 0:  # a marker one half of which shows the other colour
            cells[1:-1, 1:-1] = known[rng.integers(len(known))] ^ (np.arange(4) < 2)
        if (known != cells[1:-1, 1:-1]).sum(axis=(1, 2)).min() < 2:
            continue
        image = shaded(card(cells), rng.uniform(0.2, 0.8), rng.uniform(0, 6.3), rng.uniform(-9, 9), tried)
        assert marker_odds(image, corners(6), DICTIONARY).log_odds[0] < min_log_odds(DICTIONARY, robust=True)
        tried += 1


def test_markers_under_shadows_are_detected(place_markers, draw_markers, monkeypatch) -> None:
    """Each has an edge of its own; without the search for edges fewer are found."""
    middles = np.array([70 + 70j, 190 + 70j, 70 + 190j, 190 + 190j])

    def shadows(image: np.ndarray) -> None:
        rows, columns = np.indices(image.shape)
        for number, middle in enumerate(middles):
            away = (columns - middle.real) * np.cos(number) + (rows - middle.imag) * np.sin(number)
            near = np.maximum(abs(columns - middle.real), abs(rows - middle.imag)) < 55
            image[near & (away > 3)] = 0.35 * image[near & (away > 3)]

    matrices = place_markers(middles, [0.1, 0.5, 0.9, 1.3], [45.0] * 4)
    given = {"noise": 1.0, "dictionary": DICTIONARY, "paint": shadows}
    image = draw_markers(matrices, [1, 2, 3, 4], (260, 260), np.random.default_rng(3), **given)
    detector = PhotometricDetector(DICTIONARY, following=False)
    seen = detector.detect(image)
    assert len(seen) >= 3 and set(seen.ids) <= {1, 2, 3, 4}
    assert np.abs(seen.centers_px @ [1, 1j] - middles[seen.ids - 1]).max() < 1
    monkeypatch.setattr(likelihood, "MAX_SHADOW_EDGES", 0)
    assert len(detector.detect(image)) < len(seen)
