"""Plane geometry: corner order, and affine fit of a square."""

import numpy as np
import pytest

from skyherd.geometry import (
    ROBOT_FRAME_CORNERS,
    SQUARE_CORNERS,
    UNIFORM_VARIANCE,
    fit_squares,
    median,
    to_points,
)

EXACT = 1e-12
"""Chosen: a few hundred roundings of numbers of order one."""


@pytest.mark.smoke
def test_corner_order_starts_at_front_left_in_both_frames() -> None:
    """Front is -i of the marker and +1 of the robot; left is -1 of the marker and +i of the robot."""
    assert SQUARE_CORNERS[:2].imag.tolist() == [-0.5, -0.5]
    assert SQUARE_CORNERS[[0, 3]].real.tolist() == [-0.5, -0.5]
    assert ROBOT_FRAME_CORNERS[:2].real.tolist() == [0.5, 0.5]
    assert ROBOT_FRAME_CORNERS[[0, 3]].imag.tolist() == [0.5, 0.5]


@pytest.mark.parametrize("seed", range(5))
def test_affine_fit_equals_general_least_squares(seed: int) -> None:
    """Against numpy's solution of `p = c + m z + k z̄` on noisy corners, which no affine map explains."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(6, 4)) + 1j * rng.normal(size=(6, 4))
    design = np.stack([np.ones(4), SQUARE_CORNERS, SQUARE_CORNERS.conj()], axis=1)
    expected = np.linalg.lstsq(design, corners.T, rcond=None)[0]
    fitted = fit_squares(corners)
    for got, want in zip((fitted.centers, fitted.similarities, fitted.anisotropies), expected, strict=True):
        np.testing.assert_allclose(got, want, atol=EXACT, rtol=0)


@pytest.mark.parametrize("heading_rad", [0.0, 0.4, -2.9])
def test_rotated_square_has_heading_and_no_anisotropy(heading_rad: float) -> None:
    """Forward, the middle of the edge from corner 0 to corner 1, lies at the heading from the centre."""
    arm = 20 * 1j * np.exp(1j * heading_rad)
    corners = 300 + 200j + arm * SQUARE_CORNERS
    fitted = fit_squares(corners[None])
    assert fitted.headings_rad()[0] == pytest.approx(heading_rad, abs=EXACT)
    assert abs(fitted.anisotropies[0]) < 20 * EXACT
    front = to_points(corners[:2].mean() - fitted.centers[0])
    assert front == pytest.approx([10 * np.cos(heading_rad), 10 * np.sin(heading_rad)], abs=1e-9)


def test_rounding_variance_equals_uniform_distribution() -> None:
    """The mean of x² over 10⁵ midpoints of [-1/2, 1/2]; midpoints are short of it by a share of 1e-10."""
    x = (np.arange(100_000) + 0.5) / 100_000 - 0.5
    assert np.mean(x**2) == pytest.approx(UNIFORM_VARIANCE, rel=1e-9)


@pytest.mark.parametrize("count", [1, 2, 5, 16])
def test_median_of_a_few_equals_that_of_numpy(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    assert median(values) == np.median(values)
