"""Patterns and their derivatives, against markers made otherwise: summed cell by cell, and in pixels."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from skyherd.markers.dictionary import cells_per_side, marker_cells
from skyherd.vision.photometric.pattern import (
    BLUR_STEP,
    SAMPLES_PER_SIGMA,
    blur_buckets,
    make_anisotropy,
    make_pattern,
)

DICTIONARY, MARKER, BUCKET = "4X4_50", 11, -72
SIGMA = BLUR_STEP**BUCKET  # 0.030 of a side: 0.84 px on 28 px


def seen(x, y, sigma, dictionary=DICTIONARY, marker_id=MARKER):
    """T at points (x, y), (...): 1 less what each black cell adds, one after another."""
    cells = marker_cells(dictionary, marker_id)
    n = len(cells)

    def share(z, k):
        ends = [(z - (edge / n - 0.5)) / (sigma * np.sqrt(2)) for edge in (k, k + 1)]
        return (erf(ends[0]) - erf(ends[1])) / 2

    black = [(r, c) for r in range(n) for c in range(n) if not cells[r, c]]
    return 1 - sum(share(y, r) * share(x, c) for r, c in black)


@pytest.fixture(scope="module")
def pattern():
    return make_pattern(DICTIONARY, MARKER, BUCKET)


@pytest.fixture(scope="module")
def at(pattern):
    """Marker coordinates of every third sample, x and y, as an open grid."""
    axis = (np.arange(0, len(pattern.values), 3) - pattern.center) / pattern.rate
    return axis[None, :], axis[:, None]


def test_the_first_channel_is_the_marker_less_what_bilinear_reading_adds(pattern, at):
    """T - h² (T_xx + T_yy) / 12 with T summed cell by cell; what is left is float32's rounding."""
    values = pattern.values[::3, ::3].astype(float)
    taken_off = values[..., 3] / (12 * (SIGMA * pattern.rate) ** 2)
    np.testing.assert_allclose(values[..., 0] + taken_off, seen(*at, SIGMA), atol=5e-7)


def order(errors, sizes):
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


@pytest.mark.parametrize(("channel", "across", "down"), [(1, 1, 0), (2, 0, 1)])
def test_slopes_are_the_markers_derivatives(pattern, at, channel, across, down):
    """Central differences approach them with order 2."""
    x, y = at
    errors, sizes = [], np.array([0.2, 0.1, 0.05]) * SIGMA
    for h in sizes:
        difference = (
            seen(x + h * across, y + h * down, SIGMA) - seen(x - h * across, y - h * down, SIGMA)
        ) / (2 * h)
        errors.append(np.abs(pattern.values[::3, ::3, channel] - difference).max())
    assert order(errors, sizes) == pytest.approx(2.0, abs=0.05), errors


def test_the_blur_channel_is_the_derivative_in_log_sigma(pattern, at):
    errors, sizes = [], np.array([0.2, 0.1, 0.05])
    for h in sizes:
        difference = (seen(*at, SIGMA * np.exp(h)) - seen(*at, SIGMA * np.exp(-h))) / (2 * h)
        errors.append(np.abs(pattern.values[::3, ::3, 3] - difference).max())
    assert order(errors, sizes) == pytest.approx(2.0, abs=0.05), errors


def test_blur_spreads_as_heat_does(pattern, at):
    """T_log σ = σ² (T_xx + T_yy), by second differences, with order 2."""
    x, y = at
    errors, sizes = [], np.array([0.4, 0.2, 0.1]) * SIGMA
    for h in sizes:
        around = sum(seen(x + dx, y + dy, SIGMA) for dx, dy in ((h, 0), (-h, 0), (0, h), (0, -h)))
        bend = (around - 4 * seen(x, y, SIGMA)) / h**2 * SIGMA**2
        errors.append(np.abs(pattern.values[::3, ::3, 3] - bend).max())
    assert order(errors, sizes) == pytest.approx(2.0, abs=0.05), errors


@pytest.mark.parametrize(
    ("dictionary", "marker_id", "cells"), [("4X4_50", 3, 0.2), ("APRILTAG_36h11", 40, 0.5)]
)
def test_patterns_agree_with_a_marker_drawn_in_pixels_and_blurred(dictionary, marker_id, cells):
    """30 pixels a cell, smoothed by a sampled Gaussian: edges lie between pixels, so that sampling leaves
    `Σ` minus `∫` of a Gaussian of 6 pixels or more, under 1e-6, and the filter's cut at 6 sigma 1e-8."""
    n, fine = cells_per_side(dictionary), 30
    bucket = int(blur_buckets(np.array([cells / n]))[0])
    made, sigma = make_pattern(dictionary, marker_id, bucket), BLUR_STEP**bucket
    bitmap = np.kron(
        np.pad(marker_cells(dictionary, marker_id), 3, constant_values=True), np.ones((fine, fine))
    )
    blurred = gaussian_filter(bitmap, sigma * n * fine, truncate=6.0, mode="nearest")
    axis = (np.arange(n * fine) + 0.5) / (n * fine) - 0.5
    inside = blurred[3 * fine : -3 * fine, 3 * fine : -3 * fine]
    u, v = np.meshgrid(*[(axis * made.rate + made.center).astype(np.float32)] * 2)
    drawn = np.empty((*u.shape, 4), np.float32)
    for top in range(0, len(u), 64):  # OpenCV interpolates more coarsely in large blocks
        part = slice(top, top + 64)
        drawn[part] = cv2.remap(made.values, u[part], v[part], cv2.INTER_LINEAR)
    off = drawn[..., 0] - inside
    # Reading leaves h² / 12 (|T_xx| + |T_yy|) at most, h = σ / 3; at a corner |T_xx| + |T_yy| = 0.41 / σ².
    # Cells half as wide again as σ sharpen that no further than 0.6. Its mean is taken off.
    assert np.abs(off).max() < 0.6 / (12 * SAMPLES_PER_SIGMA**2), np.abs(off).max()
    assert abs(off.mean()) < 2e-4, off.mean()


def test_the_mean_that_bilinear_reading_adds_is_taken_off():
    """Without the correction the reading leans by `h² T'' / 12` towards the curvature; with it, by none."""
    made = make_pattern(DICTIONARY, MARKER, BUCKET)
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-0.6, 0.6, (2, 64, 500))
    points = [(z * made.rate + made.center).astype(np.float32) for z in (x, y)]
    read = cv2.remap(made.values, *points, cv2.INTER_LINEAR).astype(float)
    off = read[..., 0] - seen(x, y, SIGMA)
    bend = read[..., 3] / SAMPLES_PER_SIGMA**2 / 12
    lean = (off * bend).sum() / (bend**2).sum()
    # f (1 - f) / 2 scatters about 1/12 by 0.037, 0.45 of it: over 32000 points 0.0035; h⁴ is a ninth of h².
    assert abs(lean) < 0.06, lean
    assert ((off + bend) * bend).sum() / (bend**2).sum() > 0.9


def test_the_bend_is_what_a_blur_of_two_widths_and_a_slant_does(pattern, at):
    """A Gaussian of variances σ² (1 ∓ 2 e_x) and covariance -2 σ² e_y changes T by minus the bend times e.

    By differences of T in ever smaller e, with order 2: widths differ along the axes by how the marker, which
    separates, is seen with two sigmas; the slant is `T_xy`, by differences of T in x and y.
    """
    x, y = at
    values = make_anisotropy(DICTIONARY, MARKER, BUCKET).values[::3, ::3]
    cells = ~marker_cells(DICTIONARY, MARKER)
    edges = np.arange(len(cells) + 1) / len(cells) - 0.5

    def squeezed(e):
        wide, high = (SIGMA * np.sqrt(1 + sign * 2 * e) for sign in (-1, 1))
        across = erf((x.T - edges) / (wide * np.sqrt(2))) / 2
        down = erf((y - edges) / (high * np.sqrt(2))) / 2
        return 1 - (down[:, :-1] - down[:, 1:]) @ cells @ (across[:, :-1] - across[:, 1:]).T

    errors, sizes = [], np.array([0.1, 0.05, 0.025])
    for e in sizes:
        errors.append(np.abs(values[..., 0] + (squeezed(e) - squeezed(-e)) / (2 * e)).max())
    assert order(errors, sizes) == pytest.approx(2.0, abs=0.1), errors
    errors, sizes = [], np.array([0.2, 0.1, 0.05]) * SIGMA
    for h in sizes:
        mixed = (
            sum(a * b * seen(x + a * h, y + b * h, SIGMA) for a in (1, -1) for b in (1, -1)) / (2 * h) ** 2
        )
        errors.append(np.abs(values[..., 1] - 2 * SIGMA**2 * mixed).max())
    assert order(errors, sizes) == pytest.approx(2.0, abs=0.05), errors


def test_buckets_are_within_half_a_step():
    sigmas = np.geomspace(0.002, 0.4, 50)
    off = np.abs(np.log(BLUR_STEP ** blur_buckets(sigmas).astype(float) / sigmas))
    assert (off <= np.log(BLUR_STEP) / 2 + 1e-12).all()


def test_patterns_are_kept_and_cannot_be_written_to(pattern):
    assert make_pattern(DICTIONARY, MARKER, BUCKET) is pattern
    with pytest.raises(ValueError, match="read-only"):
        pattern.values[0, 0, 0] = 1
