"""The pixels of markers and the linear model's columns at them, against the same in NumPy, pixel by pixel."""

import tracemalloc

import numpy as np
import pytest
from pixel_reference import UNKNOWNS as NAMES
from pixel_reference import columns_of, draw
from scipy.ndimage import gaussian_filter
from tests.helpers.design_matrix_reference import (
    MIDDLE_GREY,
    PIXEL_ROW,
    DesignMatrices,
    taken,
    textures_over_noise,
)
from tests.helpers.homography_reference import blur_anisotropies

from skyherd.markers.dictionary import cells_per_side, marker_cells
from skyherd.vision.native.records import UNKNOWNS
from skyherd.vision.photometric.fitting.appearance import MarkerAppearances
from skyherd.vision.photometric.fitting.design_matrix import (
    ANISOTROPY,
    BLACK,
    BLUR,
    CONTRAST,
    DOWN,
    GROUND,
    GROW,
    KEYSTONE,
    LIGHT,
    RIGHT,
    STEEP_ANISOTROPY,
    TONE,
    TURN,
)
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.surroundings import Surroundings

DICTIONARY, MARKER, SIGMA = "4X4_50", 11, 0.03
DICTIONARIES = [
    "APRILTAG_16h5",
    "4X4_50@2",
    "5X5_50",
    "6X6_50",
    "ARUCO_MIP_36h12",
    "APRILTAG_36h11",
    "4X4_50",
]


def appearances(dictionary, ids, sigmas, **changed):
    """Of markers under blurs (N,), in sides, on a card of one cell."""
    n, count = cells_per_side(dictionary), len(ids)
    cells = [np.pad(~marker_cells(dictionary, marker), 1) for marker in ids]
    defaults = dict(
        cells=np.stack(cells).astype(np.float32),
        sigmas=np.array(sigmas, dtype=float),
        read_limits=np.full(count, 0.5 + 0.3 / n),
        reaches_ground=np.ones(count, dtype=bool),
        black_ratios=np.full(count, 0.15),
        surroundings=Surroundings.of_cards(count),
        half_card=0.5 + 1 / n,
        texture=6.0,
        round_in_image=False,
    )
    return MarkerAppearances(**(defaults | changed))


def usual(count, **changed):
    return appearances(DICTIONARY, range(count), [SIGMA] * count, **changed)


def homographies(centers, similarities, anisotropies=None, perspectives=None):
    none = np.zeros(len(centers), dtype=complex)
    return LocalHomographies(
        np.array(centers, dtype=complex),
        np.array(similarities, dtype=complex),
        none if anisotropies is None else np.array(anisotropies, dtype=complex),
        none if perspectives is None else np.array(perspectives, dtype=complex),
    )


def noise_image(seed, shape):
    return np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)


def read(image, where, looks):
    return DesignMatrices(image, np.arange(len(where)), where, looks)


def disc(rng, count, radius):
    return radius * np.sqrt(rng.uniform(size=count)) * np.exp(2j * np.pi * rng.uniform(size=count))


def test_columns_have_the_references_order():
    own = [BLACK, CONTRAST, RIGHT, DOWN, TURN, GROW, BLUR, GROUND, *ANISOTROPY, *LIGHT, *KEYSTONE, *TONE]
    assert own == list(range(len(NAMES)))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("dictionary", DICTIONARIES)
def test_columns_are_those_of_the_reference(dictionary, seed):
    """Markers anisotropic and with keystone, across the border too, with and without cards; where blur is
    round in the image, those that are drawn to first order. Under blurs of 0.03 to 0.75 cells, on cards of
    many widths. Rounding a place of some cells to single precision moves it by `2^-22 cells` and so by that
    over σ in standard deviations. An edge that is out of reach is off by 3e-7 and in its slope and curvature
    by 1.5e-6 and 7e-6; some edges are, on two axes."""
    rng, n, count = np.random.default_rng(seed), cells_per_side(dictionary), 5
    image = noise_image(seed, (70, 90))
    blurs_cells = np.exp(rng.uniform(np.log(0.03), np.log(0.75), count))
    similarities = rng.uniform(4, 45, count) * np.exp(2j * np.pi * rng.uniform(size=count))
    where = homographies(
        rng.uniform(-10, 100, count) + 1j * rng.uniform(-10, 80, count),
        similarities,
        similarities * disc(rng, count, STEEP_ANISOTROPY if seed % 2 else 0.4),
        disc(rng, count, 0.45) / np.abs(similarities),
    )
    looks = appearances(
        dictionary,
        rng.integers(0, 30, count),
        blurs_cells / n,
        read_limits=rng.uniform(0.5, 0.7, count),
        reaches_ground=rng.random(count) < 0.7,
        black_ratios=rng.uniform(0, 0.5, count),
        texture=float(rng.uniform(1, 30)),
        half_card=float(rng.uniform(0.52, 0.7)),
        round_in_image=bool(seed % 2),
        surroundings=Surroundings(
            np.where(rng.random(count) < 0.4, rng.uniform(-0.9, 0.3, count), np.nan),
            rng.uniform(0, 30, count),
        ),
    )
    drawn, bare, textures = (
        read(image, where, looks),
        looks.surroundings.is_bare(),
        textures_over_noise(looks),
    )
    for row in range(count):
        expected, places, pixels = columns_of(
            image,
            looks.cells[row, 1:-1, 1:-1] == 0,
            where,
            row,
            sigma=looks.sigmas[row],
            limit=looks.read_limits[row],
            ratio=looks.black_ratios[row],
            half_card=looks.half_card if looks.reaches_ground[row] and not bare[row] else None,
            texture=textures[row],
            round_in_image=looks.round_in_image,
            ground_level=looks.surroundings.levels[row] if bare[row] else None,
        )
        own = slice(drawn.bounds[row], drawn.bounds[row + 1])
        assert drawn.counts[row] == len(expected)
        np.testing.assert_array_equal(drawn.pixels[own], pixels)
        np.testing.assert_allclose(drawn.places[own], places, atol=1e-7)
        scales, allowed = np.ones(UNKNOWNS + 1), np.full(UNKNOWNS + 1, 1e-5)
        slopes = [RIGHT, DOWN, TURN, GROW, *ANISOTROPY, *KEYSTONE]
        scales[slopes], scales[PIXEL_ROW] = 1 / looks.sigmas[row], 128
        allowed[slopes], allowed[BLUR] = 5e-6, 2e-5
        allowed += 2**-22 / blurs_cells[row]
        off = np.abs(drawn.columns[own] - expected) / scales
        assert (off <= allowed).all(), (off / allowed).max(axis=0)
    assert len(drawn.columns) == drawn.bounds[-1] == drawn.counts.sum() > 500
    for row, gram in enumerate(drawn.gram_matrices()):
        own = drawn.columns[drawn.bounds[row] : drawn.bounds[row + 1]].astype(float)
        size = np.linalg.norm(own, axis=0)
        np.testing.assert_allclose(gram, own.T @ own, atol=1e-12 + 1e-6 * (size[:, None] * size).max())


def points(seed, count=400):
    return np.random.default_rng(seed).uniform(-0.6, 0.6, (2, count))


def order(errors, sizes):
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


WHITE = marker_cells(DICTIONARY, MARKER)


@pytest.mark.parametrize(
    ("name", "difference"),
    [
        ("x", lambda x, y, h: (at(x + h, y) - at(x - h, y)) / (2 * h)),
        ("y", lambda x, y, h: (at(x, y + h) - at(x, y - h)) / (2 * h)),
        ("xx", lambda x, y, h: (at(x + h, y) - 2 * at(x, y) + at(x - h, y)) / h**2),
        ("yy", lambda x, y, h: (at(x, y + h) - 2 * at(x, y) + at(x, y - h)) / h**2),
        (
            "xy",
            lambda x, y, h: (
                sum(a * b * at(x + a * h, y + b * h) for a in (1, -1) for b in (1, -1)) / (2 * h) ** 2
            ),
        ),
    ],
)
def test_reference_derivatives_match_finite_differences(name, difference):
    """With order 2."""
    x, y = points(0)
    sizes = np.array([0.2, 0.1, 0.05]) * SIGMA
    exact = getattr(draw(WHITE, x, y, SIGMA), name)
    errors = [np.abs(exact - difference(x, y, h)).max() for h in sizes]
    assert order(errors, sizes) == pytest.approx(2.0, abs=0.07), errors


def at(x, y, sigma=SIGMA):
    return draw(WHITE, x, y, sigma).value


def test_blur_spreads_as_heat_does():
    """T_log σ = σ² (T_xx + T_yy), by differences in log σ, with order 2."""
    x, y = points(1)
    exact = draw(WHITE, x, y, SIGMA)
    sizes = np.array([0.2, 0.1, 0.05])
    errors = [
        np.abs(
            SIGMA**2 * (exact.xx + exact.yy)
            - (at(x, y, SIGMA * np.exp(h)) - at(x, y, SIGMA * np.exp(-h))) / (2 * h)
        ).max()
        for h in sizes
    ]
    assert order(errors, sizes) == pytest.approx(2.0, abs=0.05), errors


@pytest.mark.parametrize(
    ("dictionary", "marker_id", "cells"), [("4X4_50", 3, 0.2), ("APRILTAG_36h11", 40, 0.5)]
)
def test_the_reference_is_a_marker_drawn_in_pixels_and_blurred(dictionary, marker_id, cells):
    """30 pixels a cell, smoothed by a sampled Gaussian. Edges lie between pixels, so that a sum up to one is
    the midpoint rule for Φ, off by `φ' / 24` in pixels, 0.242 / 24 / σ² at most; four edges are in reach."""
    n, fine, white = cells_per_side(dictionary), 30, marker_cells(dictionary, marker_id)
    bitmap = np.kron(np.pad(white, 3, constant_values=True), np.ones((fine, fine)))
    blurred = gaussian_filter(bitmap, cells * fine, truncate=6.0, mode="nearest")
    axis = (np.arange(n * fine) + 0.5) / (n * fine) - 0.5
    drawn = draw(white, axis[None, ::7], axis[::7, None] + 0 * axis[None, ::7], cells / n).value
    np.testing.assert_allclose(
        drawn,
        blurred[3 * fine : -3 * fine, 3 * fine : -3 * fine][::7, ::7],
        rtol=0,
        atol=4 * 0.242 / 24 / (cells * fine) ** 2,
    )


@pytest.mark.parametrize("direction", [0.0, 0.5 * np.pi, -2.0])
def test_blur_that_is_round_in_the_image_is_drawn_so(direction):
    """The reference for an anisotropy e, with a = e / (1 + |e|²), has two blurs in the marker: a round one of
    variance σ² (1 - 2 |a|), and a line of variance 4 |a| σ² across half the direction of e. The drawing is
    off by an order 2 in e; if blur is drawn round in the marker, by an order 1.
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(30)
    sizes, off = np.array([0.04, 0.02, 0.01]), {True: [], False: []}
    for size in sizes:
        where = homographies([16.3 + 16.1j], [24.0], [24 * size * np.exp(1j * direction)])
        sigma, a = where.blurs(0.72)[0], np.abs(blur_anisotropies(where)[0])
        line = 1j * np.exp(0.5j * direction) * 2 * np.sqrt(a) * sigma * nodes
        for round_in_image, errors in off.items():
            looks = appearances(DICTIONARY, [MARKER], [sigma], round_in_image=round_in_image)
            drawn = read(np.zeros((33, 33), np.uint8), where, looks)
            x, y = drawn.places.astype(float).T[..., None]
            seen = at(x + line.real, y + line.imag, sigma * np.sqrt(1 - 2 * a)) @ weights / weights.sum()
            errors.append(np.std(drawn.columns[:, CONTRAST] / drawn.columns[:, BLACK] - seen))
    assert order(off[True], sizes) == pytest.approx(2.0, abs=0.1), off
    assert order(off[False], sizes) == pytest.approx(1.0, abs=0.1), off


@pytest.mark.parametrize("horizon", [0.0, 0.002 - 0.001j])
def test_places_are_exact_far_from_the_images_origin(horizon):
    """To the rounding of single precision, also 3000 px away."""
    image = noise_image(1, (90, 3000))
    where = homographies([2950.3 + 40.7j], [20 * np.exp(0.4j)], [1.0 + 0.5j], [horizon])
    pixels = read(image, where, usual(1))
    seen = where.images(pixels.places.astype(float) @ [1, 1j])[0]
    np.testing.assert_allclose(seen, pixels.pixels @ [1j, 1], rtol=0, atol=4e-6)


def test_means_over_cells_are_those_of_the_pixels_in_them():
    """With nothing explained, each cell's mean is that of its own pixels, also of those left over."""
    image = noise_image(2, (80, 160))
    where = homographies([40.2 + 39.6j, 120.7 + 40.1j], [30.0, 29.0 * np.exp(0.7j)])
    pixels = read(image, where, usual(2, reaches_ground=np.zeros(2, dtype=bool)))
    used = np.random.default_rng(3).random(len(pixels.columns)) < 0.6
    for restricted in (False, True):
        if restricted:
            pixels.leave_out(~used)
        means, peaks, _ = pixels.cell_residuals(np.zeros((2, UNKNOWNS)), 6)
        for row, (begin, end) in enumerate(zip(pixels.bounds[:-1], pixels.bounds[1:], strict=True)):
            v, u = pixels.pixels[begin:end].T
            kept = used[begin:end] | (not restricted)
            grey = image[v, u] - MIDDLE_GREY
            assert peaks[row] == np.abs(grey[kept]).max()
            column, line = np.floor(6 * (pixels.places[begin:end].T + np.float32(0.5))).astype(int)
            for j in range(6):
                for k in range(6):
                    own = (column == k) & (line == j)
                    assert means[row, j, k] == pytest.approx(grey[own & kept].mean(), rel=1e-5)


def test_residuals_are_what_the_model_leaves():
    image = noise_image(4, (60, 120))
    where = homographies([30 + 30j, 85.5 + 29.2j], [24.0, 20 * np.exp(1.1j)])
    pixels, solutions = read(image, where, usual(2)), np.random.default_rng(5).normal(0, 20, (2, UNKNOWNS))
    model = np.repeat(solutions, pixels.counts, axis=0)
    expected = pixels.columns[:, PIXEL_ROW] - (pixels.columns[:, :UNKNOWNS] * model).sum(axis=1)
    np.testing.assert_allclose(pixels.residuals(solutions), expected, atol=1e-3)


def test_marker_larger_than_the_image_costs_no_more_than_it():
    """A fit that ran away: every pixel of 100 x 80 is its, and no more memory is asked for than for them."""
    where, looks = homographies([50 + 40j], [1e6 + 1e6j]), usual(1)
    read(noise_image(0, (80, 100)), where, looks)
    tracemalloc.start()
    pixels = read(noise_image(0, (80, 100)), where, looks)
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert pixels.counts.tolist() == [8000]
    assert len(np.unique(pixels.pixels, axis=0)) == 8000
    assert peak_bytes < 2e6


BAD_PLACES = {
    "outside": homographies([500 + 40j, -1e9 + 1e300j], [20, 20]),
    "not a number": homographies([np.nan, 30 + 30j, complex(30, np.nan)], [20, np.nan, 20]),
    "infinite": homographies([np.inf, 30 + 30j, 30 - 1j * np.inf], [20, np.inf, 20]),
    "a horizon that is not a number": homographies([30 + 30j] * 2, [20, 20], None, [np.nan, np.inf]),
    "tiny": homographies([30.5 + 30.5j] * 2, [1e-6, 1e-150]),
    "before the horizon only": homographies([30 + 30j], [1e5], None, [1e3]),
}


@pytest.mark.parametrize("kind", BAD_PLACES)
def test_markers_without_pixels_have_columns_of_none(kind):
    """Beside a marker that is as usual, whose columns stay the same."""
    bad = BAD_PLACES[kind]
    with np.errstate(all="ignore"):
        good = homographies([40.3 + 33.3j], [22.0])
        pixels = read(noise_image(6, (70, 80)), bad.joined(good), usual(len(bad) + 1))
    alone = read(noise_image(6, (70, 80)), good, taken(usual(len(bad) + 1), np.array([len(bad)])))
    if kind != "before the horizon only":
        assert not pixels.counts[:-1].any()
        assert not pixels.gram_matrices()[:-1].any()
    np.testing.assert_array_equal(pixels.columns[-alone.counts[0] :], alone.columns)
    means, peaks, _ = pixels.cell_residuals(np.zeros((len(bad) + 1, UNKNOWNS)), 6)
    assert np.isfinite(means).all() and np.isfinite(peaks).all()
    sums = pixels.squared_box_sums(
        np.ones((len(bad) + 1, UNKNOWNS)), np.ones((len(bad) + 1, 3, UNKNOWNS)), np.arange(len(bad) + 1), 4
    )
    assert all(np.isfinite(one).all() for one in sums)


def test_pixels_beyond_the_horizon_are_not_the_markers():
    """Image points there have places in the marker's plane too, behind the camera."""
    where = homographies([30 + 30j], [20.0], None, [0.2])
    pixels = read(noise_image(0, (60, 60)), where, usual(1)).pixels
    near = 1 - 0.2 * (pixels[:, 1] - 30)
    assert near.min() > 0 and np.ptp(near) > 1


@pytest.mark.parametrize("sigma", [0.0, 1e-300, 1e-30, 1e-5, 1e3, 1e30, 1e300])
def test_any_blur_is_drawn_without_a_number_that_is_not_finite(sigma):
    """Blurs beyond `SIGMA_LIMITS` as of those."""
    where = homographies([30 + 30j, 30.25 + 31j], [20.0, 24 * np.exp(1j)])
    pixels = read(noise_image(7, (60, 60)), where, appearances("APRILTAG_36h11", [0, 1], [sigma] * 2))
    assert np.isfinite(pixels.columns).all()
    assert (np.abs(pixels.columns[:, CONTRAST]) <= 1 + 1e-5).all()


def test_nan_blur_leaves_its_marker_without_pixels():
    where, nan = homographies([30 + 30j, 30.25 + 31j], [20.0, 24 * np.exp(1j)]), float("nan")
    pixels = read(noise_image(7, (60, 60)), where, appearances(DICTIONARY, [0, 1], [nan, SIGMA]))
    assert pixels.counts[0] == 0 < pixels.counts[1]


def test_a_view_of_an_image_is_read_as_its_copy_is():
    image, where = noise_image(8, (120, 140)), homographies([30 + 30j], [20.0])
    view = image[::2, ::-2]
    np.testing.assert_array_equal(
        read(view, where, usual(1)).columns, read(view.copy(), where, usual(1)).columns
    )
