"""Blurred cells against a direct convolution, and correlations against NumPy."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from skyherd.markers.dictionary import marker_cells
from skyherd.vision.blurred_cells import blurred_darkness, standardised

FINE = 40


@pytest.mark.parametrize("blur_cells", [0.2, 0.5, 1.0])
@pytest.mark.parametrize(("per_cell", "samples"), [(1, 1), (3, 1), (1, 2)])
def test_darkness_matches_a_direct_gaussian_blur(blur_cells, per_cell, samples):
    """The reference has 40 pixels a cell and a white margin.

    Positions differ by at most half a pixel, 0.013 cells, at an edge of slope 0.4 / blur_cells.
    """
    white = marker_cells("4X4_50", 7)
    margin = 6
    drawn = np.pad(np.kron(~white, np.ones((FINE, FINE))), margin * FINE)
    drawn = gaussian_filter(drawn, blur_cells * FINE)
    n = len(white)
    places = (np.arange(n * per_cell * samples) + 0.5) / (per_cell * samples)
    pixels = np.rint((places + margin) * FINE - 0.5).astype(int)
    seen = (
        drawn[np.ix_(pixels, pixels)].reshape(n * per_cell, samples, n * per_cell, samples).mean(axis=(1, 3))
    )
    darkness = blurred_darkness(white[None], blur_cells, per_cell, samples)[0]
    np.testing.assert_allclose(darkness, seen, atol=2 * 0.013 * 0.4 / blur_cells)


def test_correlations_match_numpy_for_any_gain_and_offset():
    rng = np.random.default_rng(0)
    patterns, readings = rng.normal(size=(5, 36)), rng.normal(size=(3, 36))
    expected = np.corrcoef(readings, patterns)[:3, 3:]
    for seen in (readings, 7 + 30 * readings):
        correlations = standardised(seen) @ standardised(patterns).T / 36
        np.testing.assert_allclose(correlations, expected, atol=1e-12)


def test_uniform_samples_have_correlation_zero():
    assert not standardised(np.full((1, 36), 5.0)).any()
