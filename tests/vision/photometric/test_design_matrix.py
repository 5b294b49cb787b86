"""The pixels of markers and what is drawn at them: where they are, and what of the ground they see."""

import tracemalloc

import numpy as np
import pytest
from scipy.special import ndtr

from skyherd.vision.photometric.appearance import MarkerAppearances, ground_share
from skyherd.vision.photometric.design_matrix import BLACK, PIXEL_ROW, UNKNOWNS, design_matrices_of
from skyherd.vision.photometric.local_homography import LocalHomographies
from skyherd.vision.photometric.pattern import blur_buckets, make_pattern
from skyherd.vision.photometric.pixel_support import pixels_within

DICTIONARY, SIGMA, HALF_CARD = "4X4_50", 0.03, 0.5 + 1 / 6
ROUND = np.zeros(1, dtype=complex)


def appearances(count, *, reaches_ground=True, limit=0.55):
    """Of markers 0, 1, ... under a blur of `SIGMA`."""
    bucket = int(blur_buckets(np.array([SIGMA]))[0])
    return MarkerAppearances(
        patterns=[make_pattern(DICTIONARY, marker, bucket) for marker in range(count)],
        anisotropies=[],
        sigmas=np.full(count, SIGMA),
        read_limits=np.full(count, limit),
        reaches_ground=np.full(count, reaches_ground),
        black_ratios=np.full(count, 0.15),
        half_card=HALF_CARD,
        texture=6.0,
    )


def homographies(centers, arms, squeezes=None, horizons=None):
    none = np.zeros(len(centers), dtype=complex)
    return LocalHomographies(
        np.array(centers, dtype=complex),
        np.array(arms, dtype=complex),
        none if squeezes is None else np.array(squeezes, dtype=complex),
        none if horizons is None else np.array(horizons, dtype=complex),
    )


def test_ground_is_seen_beyond_the_card_only():
    """As the law has it: entries are 1/64 σ apart, so that nearest ones are off by `φ(0) / 128`: 0.003."""
    x, y = (z.ravel()[None].astype(np.float32) for z in np.mgrid[-0.9:0.9:61j, -0.9:0.9:61j])
    seen = ground_share(x, y, appearances(1), ROUND)
    inside = (ndtr((z + HALF_CARD) / SIGMA) - ndtr((z - HALF_CARD) / SIGMA) for z in (x, y))
    law = 1 - np.prod(list(inside), axis=0)
    np.testing.assert_allclose(seen, law, atol=2 * 0.0032)
    assert seen.min() < 1e-4
    assert seen.max() > 1 - 1e-4
    assert not ground_share(x, y, appearances(1, reaches_ground=False), ROUND).any()


@pytest.mark.parametrize("squeeze", [0.14, -0.14, 0.1 - 0.1j])
def test_blur_is_not_round_in_a_squeezed_marker(squeeze):
    """The image's round blur through the inverse of `z + e z̄`: its covariance there, of mean
    variance σ², and the law along each axis; entries are 1/64 σ apart."""
    x, y = (z.ravel()[None].astype(np.float32) for z in np.mgrid[-0.9:0.9:61j, -0.9:0.9:61j])
    e = complex(squeeze)
    image_marker = np.array([[1 + e.real, e.imag], [e.imag, 1 - e.real]])
    variances = np.diag(np.linalg.inv(image_marker @ image_marker.T))
    deviations = SIGMA * np.sqrt(variances / variances.mean())
    inside = [
        ndtr((z + HALF_CARD) / deviation) - ndtr((z - HALF_CARD) / deviation)
        for z, deviation in zip((x, y), deviations, strict=True)
    ]
    seen = ground_share(x, y, appearances(1), np.array([e]))
    np.testing.assert_allclose(seen, 1 - np.prod(inside, axis=0), atol=2 * 0.0032)


@pytest.mark.parametrize("horizon", [0.0, 0.002 - 0.001j])
def test_pixels_are_those_within_the_limits_and_know_where_they_are(horizon):
    """Against every pixel of the image asked one by one, over the border and far from the origin too.

    Places are right to the rounding of single precision at some tens of pixels, 4e-6 px.
    """
    width, height = 3000, 90
    image = np.random.default_rng(1).integers(0, 255, (height, width)).astype(np.uint8)
    where = homographies(
        [2950.3 + 40.7j, 12.4 + 8.9j, 1500.5 + 89.2j],
        [20 * np.exp(0.4j), 24 * np.exp(2.0j), 22.0],
        [1.0 + 0.5j, 0.0, -0.7j],
        [horizon] * 3,
    )
    (pixels,) = design_matrices_of(image, np.arange(3), where, appearances(3))
    v, u = np.mgrid[:height, :width]
    for row, (across, down) in enumerate(zip(*where.axes(), strict=True)):
        p = u + 1j * v - where.centers[row]
        nearness = 1 - (np.conj(where.horizons[row]) * p).real
        x, y = (across.conjugate() * p).real, (down.conjugate() * p).real
        x, y = x / nearness, y / nearness
        inside = (np.abs(x) <= 0.55) & (np.abs(y) <= 0.55)
        weights = pixels.columns[row, BLACK]
        used = weights > 0
        assert pixels.counts[row] == inside.sum() == used.sum()
        np.testing.assert_allclose(pixels.x[row, used], x[inside], atol=1e-6)
        np.testing.assert_allclose(pixels.y[row, used], y[inside], atol=1e-6)
        np.testing.assert_allclose(
            pixels.columns[row, PIXEL_ROW, used], (image[inside] - 128.0) * weights[used]
        )
        assert not pixels.columns[row, :, ~used].any()


def test_means_over_cells_are_those_of_the_pixels_in_them():
    """With nothing explained, each cell's mean is that of its own pixels; padding counts in none."""
    image = np.random.default_rng(2).integers(0, 255, (80, 160)).astype(np.uint8)
    where = homographies([40.2 + 39.6j, 120.7 + 40.1j], [30.0, 29.0 * np.exp(0.7j)])
    (pixels,) = design_matrices_of(image, np.arange(2), where, appearances(2, reaches_ground=False))
    means, _ = pixels.cell_residuals(np.zeros((2, UNKNOWNS)), 6)
    v, u = np.mgrid[:80, :160]
    for row, (across, down) in enumerate(zip(*where.axes(), strict=True)):
        p = u + 1j * v - where.centers[row]
        column, line = ((6 * ((axis.conjugate() * p).real + 0.5)) for axis in (across, down))
        for j, k in ((0, 0), (3, 3), (2, 5)):
            own = (np.floor(column) == k) & (np.floor(line) == j)
            assert means[row, j, k] == pytest.approx(image[own].mean() - 128.0, rel=1e-4)


def test_a_marker_much_larger_than_the_image_costs_no_more_than_the_image():
    """A fit that ran away: every pixel of 100 x 80 is its, and no more memory is asked for than for them."""
    tracemalloc.start()
    support = pixels_within(homographies([50 + 40j], [1e6 + 1e6j]), np.array([0.5]), (80, 100))
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert support.counts.tolist() == [8000]
    assert sorted(support.flat_indices[0, :8000].tolist()) == list(range(8000))
    assert peak_bytes < 4e6
