"""Variances of poses where noise is correlated from pixel to pixel, and edges where a tone curve is bent."""

from itertools import product

import cv2
import numpy as np
import pytest
from tests.helpers.fit_reference import box_ratios
from tests.helpers.fit_stages import BLOCK_PX, MarkerBlocks, stages

from skyherd.bench.detectors.design import Cell
from skyherd.bench.detectors.frames import rendered_frames
from skyherd.geometry import to_complex
from skyherd.vision.native.records import UNKNOWNS
from skyherd.vision.photometric.detector import PhotometricDetector
from skyherd.vision.photometric.fitting import common_unknowns
from skyherd.vision.photometric.fitting.correlated_noise import (
    FORGOTTEN,
    MAX_RATIO,
    RATIO_ERROR,
    SIGNIFICANT_SIGMAS,
    PooledRatios,
)
from skyherd.vision.photometric.fitting.design_matrix import BLACK

DICTIONARY, NOISE = "4X4_50", 5.0


def box_sums_by_hand(values, u, v, box_px):
    """Σ over boxes of `(Σ values)²`, box by box."""
    sums = {}
    for value, column, line in zip(values, u, v, strict=True):
        key = (int(column) // box_px, int(line) // box_px)
        sums[key] = sums.get(key, 0.0) + value
    return sum(total**2 for total in sums.values()), len(sums)


def blocks_of(counts, pixels, columns):
    """Return the blocks of pixels (P, 2) of N markers, `counts` (N,), with columns (P, 16), and no places."""
    bounds = np.concatenate([[0], np.cumsum(-(-counts // BLOCK_PX))])
    places, kept, made = (
        np.zeros((bounds[-1], size, BLOCK_PX), kind)
        for size, kind in ((2, np.float32), (2, np.int32), (UNKNOWNS + 1, np.float32))
    )
    blocks = MarkerBlocks(bounds, counts, places, kept, made)
    for of_blocks, of_pixels in ((kept, pixels), (made, columns)):
        np.moveaxis(of_blocks, 1, 2)[blocks.is_pixel()] = of_pixels
    return blocks


def test_boxes_are_added_up_as_by_hand():
    """Of markers with 300 random pixels of 64 x 64, with 200, a third of them left out, and with none."""
    rng = np.random.default_rng(0)
    bounds = np.array([0, 300, 500, 500])
    columns = rng.normal(size=(500, UNKNOWNS + 1)).astype(np.float32)
    columns[:, BLACK] = np.abs(columns[:, BLACK])
    columns *= ((np.arange(500) < 300) | (rng.random(500) < 2 / 3))[:, None]
    places = np.concatenate([rng.permutation(64 * 64)[:count] for count in (300, 200)])
    # Boxes are counted from the first pixel that is used, so that large ones are aligned with it.
    places[[0, 300]], columns[300, BLACK] = 0, 1.0
    pixels = np.stack(np.divmod(places, 64), axis=1).astype(np.int32)
    blocks = blocks_of(np.diff(bounds), pixels, columns)
    solutions = rng.normal(size=(3, UNKNOWNS)).astype(np.float32)
    influences = rng.normal(size=(3, 3, UNKNOWNS)).astype(np.float32)
    small, large, boxes = stages().squared_box_sums(blocks, solutions, influences, np.array([1, 2, 0]), 2)
    residuals = stages().residuals(blocks, solutions)
    assert not small[1].any() and not large[1].any() and not boxes[1]
    for place, marker in ((0, 1), (2, 0)):
        own = np.arange(bounds[marker], bounds[marker + 1])
        own = own[columns[own, BLACK] > 0]
        v, u = pixels[own].T
        for quantity in range(3):
            values = columns[own, :UNKNOWNS] @ influences[marker, quantity] * residuals[own]
            expected, _ = box_sums_by_hand(values, u, v, 2)
            assert small[place, quantity] == pytest.approx(expected, rel=1e-5)
            expected, count = box_sums_by_hand(values, u, v, 4)
            assert large[place, quantity] == pytest.approx(expected, rel=1e-5) and boxes[place] == count


def test_ratios_are_of_positions_and_of_headings():
    small, large = np.array([[1.0, 2.0, 3.0]]), np.array([[2.0, 3.0, 5.0]])
    ratios = box_ratios(small, large, np.array([[1.0, 2.0, 1.0]]))
    assert ratios[0, 0] / ratios[0, 1] == pytest.approx((3 / 1 + 4 / 2) / 2 / 7)


def test_ratios_near_one_count_as_one_and_old_images_expire():
    assert PooledRatios().factors().tolist() == [1.0, 1.0]
    limit = SIGNIFICANT_SIGMAS * RATIO_ERROR / np.sqrt(2500)
    one = PooledRatios().updated(np.array([[1 + 0.99 * limit, 1 + 1.01 * limit]]), np.array([2500.0]))
    np.testing.assert_allclose(one.factors(), [1.0, 1 + 1.01 * limit])
    boxes = np.array([300.0, 100.0, 0.0])
    many = PooledRatios().updated(np.array([[3.0, 4.0], [7.0, 8.0], [1e9, 1e9]]), boxes)
    np.testing.assert_allclose(many.factors(), [4.0, 5.0])
    later = many.updated(np.full((1, 2), 9.0), np.array([400.0]))
    np.testing.assert_allclose(
        later.factors(), ((1 - FORGOTTEN) * np.array([4.0, 5.0]) + 9) / (2 - FORGOTTEN)
    )
    huge = PooledRatios().updated(np.full((1, 2), 1e9), np.array([100.0]))
    assert huge.factors().tolist() == [MAX_RATIO, MAX_RATIO]


@pytest.fixture(scope="module")
def quiet():
    """Frames of 16 markers of 30 px without any noise but that of rounding, of three cameras."""
    cell = Cell(side_px=30.0, noise=0.0, blur_px=0.8, cameras=3, frames=3)
    return [frame for frame in rendered_frames(cell, DICTIONARY, 5) if frame.whole.all()]


def smoothed(white):
    noise = cv2.GaussianBlur(white, (0, 0), 0.9)
    return noise * NOISE / noise.std()


def sharpened(white):
    noise = 2.0 * white - cv2.GaussianBlur(white, (0, 0), 1.2)
    return noise * NOISE / noise.std()


def nees(frames, noise_of, *, seeds=(7, 8, 9, 10)):
    """Mean of error² over the variance reported, of positions along u and v, and of headings."""
    positions, headings = [], []
    for rng, frame in product([np.random.default_rng(seed) for seed in seeds], frames):
        noise = noise_of(rng.normal(0, NOISE, frame.image.shape))
        noisy = np.clip(np.rint(frame.image + noise), 0, 255).astype(np.uint8)
        seen = PhotometricDetector(DICTIONARY, following=False).detect(noisy)
        assert seen.ids.tolist() == frame.ids.tolist()
        off = to_complex(seen.centers_px - frame.centers_px)
        variances = np.diagonal(seen.covariances, axis1=1, axis2=2)
        positions += [*(off.real**2 / variances[:, 0]), *(off.imag**2 / variances[:, 1])]
        turn = np.angle(np.exp(1j * (seen.headings_rad - frame.headings_rad)))
        headings += [*(turn**2 / variances[:, 2])]
    return np.mean(positions), np.mean(headings)


@pytest.mark.parametrize(
    ("noise_of", "expected", "alone"),
    [
        pytest.param(np.asarray, (0.98, 1.03), 1.0, id="white", marks=pytest.mark.slow),
        pytest.param(smoothed, (1.16, 1.32), 3.0, id="smooth"),
        pytest.param(sharpened, (0.82, 0.79), 0.6, id="sharp"),
    ],
)
def test_covariances_hold_where_noise_is_correlated(quiet, noise_of, expected, alone, monkeypatch):
    """Without the ratio, smooth noise moves markers by more than stated, sharpened noise by less.

    The expected means are measured over 16 other seeds. They differ from 1 because a fit removes more than
    `KEPT_SHARE` of smooth noise, and ratios below 1 are known less precisely. The mean of 1152 squares has a
    standard deviation of `sqrt(2 / 1152)` = 0.04 of itself, that of 576 has 0.06. Three of them are allowed.
    """
    position, heading = nees(quiet, noise_of)
    assert position == pytest.approx(expected[0], rel=0.12) and heading == pytest.approx(
        expected[1], rel=0.18
    )
    monkeypatch.setattr(PooledRatios, "factors", lambda self: np.ones(2))
    without, _ = nees(quiet, noise_of, seeds=(7,))
    assert without > alone if alone > 1 else without < 1.45 * alone


def test_a_bent_tone_curve_moves_no_marker(quiet, monkeypatch):
    """Light to the power of 1 / 2.2, as cameras deliver it: errors, and how much larger they are without."""

    def errors():
        off = []
        for number, frame in enumerate(quiet):
            noise = np.random.default_rng([9, number]).normal(0, 1.0, frame.image.shape)
            bent = 255 * (np.clip(frame.image + noise, 0, 255) / 255) ** (1 / 2.2)
            seen = PhotometricDetector(DICTIONARY, following=False).detect(np.rint(bent).astype(np.uint8))
            assert seen.ids.tolist() == frame.ids.tolist()
            off += [*(seen.centers_px - frame.centers_px).ravel()]
        return float(np.sqrt(np.mean(np.square(off))))

    free = errors()
    monkeypatch.setattr(common_unknowns, "FREE_SIGMAS", np.inf)
    held = errors()
    assert held > 1.5 * free
