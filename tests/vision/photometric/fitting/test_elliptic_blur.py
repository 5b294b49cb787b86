"""Markers under blur that differs along its directions, against the same on a fine lattice."""

import numpy as np
import pytest
from scipy import ndimage
from tests.helpers.design_matrix_reference import DesignMatrices, second_derivative_maps

from skyherd.markers.dictionary import cells_per_side, marker_cells
from skyherd.vision.photometric.fitting.appearance import MarkerAppearances
from skyherd.vision.photometric.fitting.design_matrix import BLUR, CONTRAST, GROUND, RIGHT
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.surroundings import Surroundings

DICTIONARY, MARKER, FINE = "4X4_50", 11, 12
SIZE = 60
IMAGE = np.full((SIZE, SIZE), 128, dtype=np.uint8)


def drawn(where, sigma_px, streak_px2, ground_level=np.nan):
    n = cells_per_side(DICTIONARY)
    looks = MarkerAppearances(
        cells=np.pad(~marker_cells(DICTIONARY, MARKER), 1).astype(np.float32)[None],
        sigmas=where.blurs(sigma_px),
        read_limits=np.array([0.5 + 0.5 / n]),
        reaches_ground=np.array([False]),
        black_ratios=np.array([0.15]),
        surroundings=Surroundings(np.array([ground_level]), np.zeros(1)),
        half_card=0.5 + 1 / n,
        texture=6.0,
        round_in_image=True,
        streak_px2=streak_px2,
    )
    return DesignMatrices(IMAGE, np.array([0]), where, looks)


def on_lattice(where, sigma_px, streak_px2, ground=1.0):
    """Sample the marker at 12 points a pixel along each axis, and blur it by FFT."""
    count, n = SIZE * FINE, cells_per_side(DICTIONARY)
    points = (np.arange(count) + 0.5) / FINE - 0.5
    away = points[None, :] + 1j * points[:, None] - where.centers[0]
    x_axis, y_axis = (axis[0] for axis in where.axes())
    w = 1 / (1 - (where.perspectives[0].conj() * away).real)
    column, row = (np.floor(((axis.conj() * away).real * w + 0.5) * n) for axis in (x_axis, y_axis))
    inside = (column >= 0) & (column < n) & (row >= 0) & (row < n)
    white = np.full((count, count), ground)
    white[inside] = marker_cells(DICTIONARY, MARKER)[row[inside].astype(int), column[inside].astype(int)]
    f_v, f_u = np.meshgrid(*[2 * np.pi * np.fft.fftfreq(count, 1 / FINE)] * 2, indexing="ij")
    q, s = streak_px2, sigma_px**2
    decay = np.exp(-((s + q.real) * f_u**2 + (s - q.real) * f_v**2 + 2 * q.imag * f_u * f_v) / 2)
    blurred = np.fft.ifft2(np.fft.fft2(white) * decay).real
    return lambda pixels: ndimage.map_coordinates(
        blurred, ((pixels.T + 0.5) * FINE - 0.5).astype(float), order=1
    )


def shape(anisotropy, keystone, turn):
    similarity = 22.0 * np.exp(1j * turn)
    one = [
        np.array([number], dtype=complex) for number in (29.3 + 30.1j, similarity, anisotropy * similarity)
    ]
    return LocalHomographies(*one, np.array([keystone / 22.0 * np.exp(0.7j)]))


@pytest.mark.parametrize(
    ("where", "streak_px2"),
    [
        (shape(0.0, 0.0, 0.3), 0.65 * np.exp(0.9j)),
        (shape(0.33 * np.exp(1.1j), 0.1, 0.8), 0j),
        (shape(0.5j, 0.05, 0.2), 0j),
        (shape(0.3 * np.exp(2j), 0.1, 2.5), 0.3 * np.exp(-2j)),
    ],
)
def test_markers_under_elliptic_blur_are_those_of_a_fine_lattice(where, streak_px2):
    """Streaks of 4 px and tilts of 60 and 70 degrees, with keystone too, under a blur of 1 px. The lattice is
    right to about 0.003, an edge's place to 1/24 px times its slope, the mean over an edge's points; Mehler's
    series to 0.004 at the steepest. Blur taken as round, the negative control, is off by 0.05."""
    seen = drawn(where, 1.0, streak_px2)
    expected = on_lattice(where, 1.0, streak_px2)(seen.pixels)
    assert np.abs(seen.columns[:, CONTRAST] - expected).max() < 0.01
    assert np.sqrt(np.mean((seen.columns[:, CONTRAST] - expected) ** 2)) < 0.003
    if streak_px2:
        round_blur = drawn(where, 1.0, 0j)
        assert np.abs(round_blur.columns[:, CONTRAST] - expected).max() > 0.05


@pytest.mark.parametrize(
    ("where", "streak_px2"),
    [(shape(0.0, 0.0, 0.3), 0.65 * np.exp(0.9j)), (shape(0.33 * np.exp(1.1j), 0.1, 0.8), 0j)],
)
def test_elliptic_blur_of_marker_without_card(where, streak_px2):
    """Ground darker than white by 0.6 of the contrast, at the limits of the test above."""
    level = -0.6
    seen = drawn(where, 1.0, streak_px2, level)
    expected = on_lattice(where, 1.0, streak_px2, 1 + level)(seen.pixels)
    found = seen.columns[:, CONTRAST] + level * seen.columns[:, GROUND]
    assert np.abs(found - expected).max() < 0.01
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.003
    assert np.ptp(seen.columns[:, GROUND]) > 0.9


def test_derivatives_are_differences():
    """By the streak, by the blur and by the place, of a marker that is anisotropic and has a streak: to what
    the series leaves out of derivatives, a tenth of the largest."""
    where, q = shape(0.2 * np.exp(1j), 0.0, 0.4), 0.3 * np.exp(0.5j)
    seen, step = drawn(where, 1.0, q), 1e-2
    by_streak = seen.bends @ second_derivative_maps(where)[0]
    for part, column in zip((1, 1j), by_streak.T, strict=True):
        up, down = (drawn(where, 1.0, q + sign * step * part).columns[:, CONTRAST] for sign in (1, -1))
        numbers = (up.astype(float) - down) / (2 * step)
        assert np.abs(column - numbers).max() < 0.1 * np.abs(numbers).max()
    up, down = (drawn(where, np.exp(sign * step), q).columns[:, CONTRAST] for sign in (1, -1))
    numbers = (up.astype(float) - down) / (2 * step)
    assert np.abs(seen.columns[:, BLUR] - numbers).max() < 0.1 * np.abs(numbers).max()
    along = where.similarities + where.anisotropies
    moved = [LocalHomographies(where.centers + s * step * along, *_rest(where)) for s in (1, -1)]
    up, down = (on_pixels(drawn(one, 1.0, q), seen.pixels) for one in moved)
    known = np.isfinite(up) & np.isfinite(down)
    numbers = (up - down)[known] / (2 * step)
    assert np.abs(seen.columns[known, RIGHT] - numbers).max() < 0.1 * np.abs(numbers).max()


def _rest(where):
    return where.similarities, where.anisotropies, where.perspectives


def on_pixels(seen, pixels):
    """The marker at given pixels, no number where it was not read."""
    table = np.full((SIZE, SIZE), np.nan)
    table[seen.pixels[:, 0], seen.pixels[:, 1]] = seen.columns[:, CONTRAST]
    return table[pixels[:, 0], pixels[:, 1]]
