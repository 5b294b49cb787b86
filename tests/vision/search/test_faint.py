"""The search for faint quadrilaterals: what smoothing keeps, and what it removes."""

import cv2
import numpy as np
import pytest

from skyherd.markers.dictionary import marker_cells
from skyherd.vision.search import faint
from skyherd.vision.search.faint import MAX_NOISE, find_faint_quads, stretched_contrasts

DICTIONARY, CELLS, CELL_PX = "APRILTAG_36h11", 8, 2


def chessboard(contrast: float, noise: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an image whose 32 black squares are markers, and their centres (32, 2), px."""
    side = CELLS * CELL_PX
    white, middles = np.ones((10 * side, 10 * side)), []
    for marker in range(32):
        row, column = divmod(2 * marker, 8)
        y, x = (row + 1) * side, (column + 1 + row % 2) * side
        cells = marker_cells(DICTIONARY, marker).astype(float)
        white[y : y + side, x : x + side] = np.kron(cells, np.ones((CELL_PX, CELL_PX)))
        middles.append((x + (side - 1) / 2, y + (side - 1) / 2))
    levels = 110 + contrast * (cv2.GaussianBlur(white, (0, 0), 0.5) - 0.5)
    levels += np.random.default_rng(seed).normal(0, noise, white.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8), np.array(middles)


def found(noise: float) -> int:
    """Return how many of 96 faint squares that touch at their corners have a quadrilateral."""
    hits = 0
    for seed in range(3):
        image, middles = chessboard(14.0, noise, seed)
        quads = find_faint_quads(image, np.zeros((0, 4, 2)), noise)
        off = np.linalg.norm(quads.mean(axis=1)[:, None] - middles, axis=2)
        hits += int((off < 1.0).any(axis=0).sum())
    return hits


def test_small_cells_under_little_noise_are_not_smoothed(monkeypatch) -> None:
    kept = found(1.5)
    monkeypatch.setattr(faint, "may_stay_sharp", lambda gains, noise: np.zeros(gains.shape, np.uint8))
    assert kept > 1.4 * found(1.5) > 0


@pytest.mark.parametrize("noise", [0.7, 2.0, 6.0])
def test_noise_after_the_gain_is_within_its_limit(noise, monkeypatch) -> None:
    rng = np.random.default_rng(1)
    image = np.clip(np.rint(rng.normal(120, noise, (240, 320))), 0, 255).astype(np.uint8)
    for stretched in stretched_contrasts(image, noise):
        assert np.std(stretched) < 1.1 * MAX_NOISE
    monkeypatch.setattr(faint, "may_stay_sharp", lambda gains, noise: np.full(gains.shape, 255, np.uint8))
    assert np.std(stretched_contrasts(image, noise)[0]) > 1.5 * MAX_NOISE
