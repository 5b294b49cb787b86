"""Readings under a line: the line and its parts are found, and no clutter becomes a marker."""

import cv2
import numpy as np
import pytest

from skyherd.markers.dictionary import marker_cells
from skyherd.vision.photometric.evidence import likelihood, lines
from skyherd.vision.photometric.evidence.likelihood import marker_odds, min_log_odds
from skyherd.vision.photometric.evidence.lines import without_line
from skyherd.vision.photometric.evidence.readings import Readings

CELL_PX, MARGIN_PX = 6, 30
DICTIONARY = "4X4_50"
SIDE_PX = 6 * CELL_PX
INK, PAINT = 30.0, 200.0


def corners() -> np.ndarray:
    """Corners (1, 4, 2) of the square."""
    low, high = MARGIN_PX - 0.5, MARGIN_PX + SIDE_PX - 0.5
    return np.array([[[low, low], [high, low], [high, high], [low, high]]])


def card(cells: np.ndarray) -> np.ndarray:
    """Grey levels of cells (6, 6) on white on grey ground."""
    levels = np.pad(np.kron(np.where(cells, PAINT, INK), np.ones((CELL_PX,) * 2)), 8, constant_values=PAINT)
    return np.pad(levels, MARGIN_PX - 8, constant_values=120.0)


def crossed(levels: np.ndarray, angle: float, offset_px: float, width_px: float, level: float) -> np.ndarray:
    """Return the image with a line, blurred by 0.6 px, with noise of 2 grey levels."""
    rows, columns = np.indices(levels.shape) - (levels.shape[0] - 1) / 2
    away = np.abs(np.cos(angle) * columns + np.sin(angle) * rows - offset_px)
    image = cv2.GaussianBlur(np.where(away <= width_px / 2, level, levels), (0, 0), 0.6)
    noise = np.random.default_rng(int(100 * angle)).normal(0, 2, levels.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def parts_within(angle: float, offset_px: float, reach_px: float) -> np.ndarray:
    """Mask (parts,) of the parts whose centres are so near to a line."""
    at = (np.arange(24) + 0.5) * CELL_PX / 3 - 4 * CELL_PX
    away = np.abs(np.cos(angle) * at + np.sin(angle) * at[:, None] - offset_px)
    return np.asarray((away <= reach_px).ravel())


@pytest.mark.parametrize("level", [INK, PAINT])
@pytest.mark.parametrize("angle", [0.1, 0.7, 1.4, 2.2, 3.0])
def test_parts_under_a_line_are_not_seen(angle: float, level: float) -> None:
    """Nine tenths of those in its middle, and none that is a cell away."""
    image = crossed(card(marker_cells(DICTIONARY, 9)), angle, 4.0, 4.0, level)
    clear, has_line = without_line(Readings.read(image, corners(), 6).all_seen(), DICTIONARY)
    assert has_line.tolist() == [True]
    hidden = clear.seen[0] == 0
    assert hidden[parts_within(angle, 4.0, 1.0)].mean() > 0.9
    assert not hidden[~parts_within(angle, 4.0, 2.0 + CELL_PX)].any()


@pytest.mark.parametrize("marker", range(0, 50, 7))
def test_a_marker_without_a_line_is_left_as_it_is(marker: int) -> None:
    levels = card(marker_cells(DICTIONARY, marker))
    readings = Readings.read(crossed(levels, 0.3, 0.0, 0.0, INK), corners(), 6).all_seen()
    clear, has_line = without_line(readings, DICTIONARY)
    assert not has_line.any() and clear.seen.all()


@pytest.mark.parametrize("most", [0, 2])
def test_markers_under_a_pen_line_are_recognised(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Seven eighths of 40, none with another id; without the search for lines, fewer than three."""
    monkeypatch.setattr(likelihood, "MAX_LINES", most)
    accepted = 0
    for number, marker in enumerate([2, 11, 17, 23, 40]):
        for turn in range(8):
            image = crossed(
                card(marker_cells(DICTIONARY, marker)), 0.2 + turn * 0.39, 3.0 * number - 6, 4.0, INK
            )
            odds = marker_odds(image, corners(), DICTIONARY)
            is_accepted = bool(odds.log_odds[0] >= min_log_odds(DICTIONARY, robust=True))
            assert not is_accepted or odds.ids[0] == marker
            accepted += is_accepted
    assert accepted >= 35 if most else accepted < 15


@pytest.mark.parametrize("level", [INK, PAINT])
def test_a_wrong_bit_is_no_line(level: float) -> None:
    """Bits one bit from a marker, of which the line through that cell would explain all."""
    rng, tried = np.random.default_rng(5), 0
    while tried < 60:
        cells = marker_cells(DICTIONARY, int(rng.integers(50))).copy()
        row, column = rng.integers(1, 5, 2)
        if cells[row, column] != (level == INK):
            continue
        cells[row, column] = not cells[row, column]
        image = crossed(card(cells), float(rng.uniform(0, 3)), 0.0, 0.0, level)
        _, has_line = without_line(Readings.read(image, corners(), 6).all_seen(), DICTIONARY)
        odds = marker_odds(image, corners(), DICTIONARY)
        assert not has_line.any() and odds.log_odds[0] < min_log_odds(DICTIONARY, robust=True)
        tried += 1


def test_sums_over_lines_equal_sums_over_their_parts() -> None:
    """By each line's definition, without its halo; lines with a part on their outline are left out."""
    made, values = lines._lines(6), np.random.default_rng(3).normal(size=(2, 576))
    sums, tried = made.sums(values), 0
    for number in range(0, made.count, 97):
        direction, line = divmod(number, made.offsets.size)
        reach_px = made.widths[line] / 2 * CELL_PX / 3
        line_px = np.pi / lines.DIRECTIONS * direction, made.offsets[line] * CELL_PX / 3
        inner, outer = (parts_within(*line_px, reach_px + change) for change in (-1e-6, 1e-6))
        if (inner == outer).all():
            np.testing.assert_allclose(sums[:, number], (values * inner).sum(axis=1), atol=1e-5)
            tried += 1
    assert tried > 20
