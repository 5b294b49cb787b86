"""Tests of a fit: its bits, on enough pixels, with no more left over than noise."""

from dataclasses import replace

import numpy as np
import pytest

from skyherd.vision.photometric.fitting.fit import fit_markers
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.image_noise import ROUNDING_NOISE, image_noise
from skyherd.vision.photometric.refine import fit_all_sizes
from skyherd.vision.photometric.verify import bits_are_right, verified

DICTIONARY, SIGMA_PX, DISTANCE = "4X4_50", 0.85, 4


def one_shape(center, similarity):
    return LocalHomographies(*(np.array([z], dtype=complex) for z in (center, similarity, 0, 0)))


# --- noise of an image ---


@pytest.mark.parametrize("noise", [1.5, 5.0, 20.0])
def test_an_images_noise_is_found(noise):
    """The median of 18750 values is known to 1.25 / sqrt(18750) / 0.8 of it, 1.2 %; five times that. Rounding
    adds 1/12 to the variance, and halves of a level to a median that is a whole number."""
    rng = np.random.default_rng(1)
    image = np.clip(np.rint(rng.normal(128, noise, (500, 600))), 0, 255).astype(np.uint8)
    truth = np.hypot(noise, np.sqrt(1 / 12))
    assert image_noise(image) == pytest.approx(truth, rel=0.06, abs=0.5 / (0.6745 * np.sqrt(6)))


def test_edges_and_markers_change_an_images_noise_little(place_markers, draw_markers):
    """A fifth of the lines of pixels cross an edge: the median moves by what a fifth of outliers moves it."""
    rng = np.random.default_rng(2)
    homes = 40 + 40j + 80 * (np.arange(16) % 4 + 1j * (np.arange(16) // 4))
    image = draw_markers(place_markers(homes, rng.uniform(-3, 3, 16), 30.0), range(16), (320, 320), rng)
    assert 4.5 < image_noise(image) < 5 * 1.45


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (3, 3), (16, 16), (1, 90), (90, 1)], ids=str)
def test_images_that_tell_no_noise_have_that_of_rounding(shape):
    assert image_noise(np.full(shape, 128, np.uint8)) == ROUNDING_NOISE


@pytest.mark.parametrize("level", [0, 255])
def test_clipped_pixels_tell_no_noise(level):
    rng = np.random.default_rng(3)
    image = np.full((400, 400), level, np.uint8)
    assert image_noise(image) == ROUNDING_NOISE
    image[:, :200] = np.rint(rng.normal(128, 6.0, (400, 200)))
    assert image_noise(image) == pytest.approx(6.0, rel=0.12)


# --- fits that are none ---


def test_a_fit_on_fewer_pixels_than_it_needs_is_none(place_markers, draw_markers):
    """Begun at 2-4 px somewhere on a marker, a fit has as many unknowns as pixels and leaves nothing of them:
    every bit seems right. None of 300 is believed, whatever its id."""
    rng = np.random.default_rng(4)
    image = draw_markers(place_markers(60 + 60j, 0.4, 60.0), [11], (120, 120), rng)
    for _ in range(20):
        centers = 60 + 60j + rng.uniform(-25, 25, 15) + 1j * rng.uniform(-25, 25, 15)
        similarities = rng.uniform(2, 4, 15) * np.exp(2j * np.pi * rng.uniform(size=15))
        start = LocalHomographies(centers, similarities, 0 * similarities, 0 * similarities)
        fits, _ = fit_markers(image, DICTIONARY, rng.integers(0, 50, 15), start, SIGMA_PX, Plane())
        assert not verified(fits, 5.0, DISTANCE)[fits.homographies.sides_px() < 8].any()


@pytest.mark.parametrize(("share", "believed"), [(0.0, True), (0.58, True), (0.62, False), (0.9, False)])
def test_marker_of_more_anisotropy_than_75_deg_is_rejected(place_markers, draw_markers, share, believed):
    """The tilt's anisotropy is `(1 - cos 75°) / (1 + cos 75°) = 0.59`; all else is of a good fit."""
    rng = np.random.default_rng(6)
    image = draw_markers(place_markers(50 + 50j, 0.4, 40.0), [11], (100, 100), rng)
    found = fit_markers(
        image, DICTIONARY, np.array([11]), one_shape(50 + 50j, 40j * np.exp(0.4j)), SIGMA_PX, Plane()
    )[0]
    assert verified(found, 5.0, DISTANCE).all()
    shapes = found.homographies
    turned = share * np.abs(shapes.similarities) * np.exp(1j)
    anisotropic = LocalHomographies(shapes.centers, shapes.similarities, turned, shapes.perspectives)
    enough = found.pixels + 10_000  # as many as any shape needs
    fits = replace(found, homographies=anisotropic, pixels=enough)
    assert verified(fits, 5.0, DISTANCE).all() == believed


def test_a_marker_out_of_the_image_is_none(place_markers, draw_markers):
    """Fitted where only a corner of it, or nothing, lies in the image."""
    rng = np.random.default_rng(5)
    image = draw_markers(place_markers(50 + 50j, 0.4, 24.0), [11], (100, 100), rng)
    for center in (-11 + 50j, 50 + 111j, -80 - 80j, 99 + 109j):
        fits, _ = fit_markers(image, DICTIONARY, np.array([11]), one_shape(center, 24.0), SIGMA_PX, Plane())
        assert not verified(fits, 5.0, DISTANCE).any()


def test_markers_seen_by_few_pixels_have_no_say_on_the_plane(place_markers, draw_markers):
    """Beside nine markers seen from straight above: the plane stays what it is without the tenth."""
    rng = np.random.default_rng(6)
    homes = 50 + 50j + 70 * (np.arange(9) % 3 + 1j * (np.arange(9) // 3))
    matrices = place_markers(homes, np.zeros(9), 30.0)
    image = draw_markers(matrices, range(9), (240, 240), rng)
    similarities = np.append(np.full(9, 30j), 3.0)
    start = LocalHomographies(np.append(homes, 85 + 85j), similarities, 0 * similarities, 0 * similarities)
    _, plane = fit_markers(image, DICTIONARY, np.append(np.arange(9), 35), start, SIGMA_PX, Plane())
    assert plane == Plane()


def test_print_contrast_is_the_same_in_any_light(place_markers, draw_markers):
    """Light that is five times less scales black and white alike: 200 / 230 of white, to 1 %."""
    rng = np.random.default_rng(9)
    image = draw_markers(place_markers(50 + 50j, 0.3, 30.0), [7], (100, 100), rng, noise=0.0)
    for light in (1.0, 0.2):
        shaded = np.rint(light * image).astype(np.uint8)
        start = one_shape(50 + 50j, 30j * np.exp(0.3j))
        fits, _ = fit_markers(shaded, DICTIONARY, np.array([7]), start, SIGMA_PX, Plane())
        assert fits.print_contrasts()[0] == pytest.approx(200 / 230, rel=0.01)


def nine_fits(place_markers, draw_markers):
    rng = np.random.default_rng(10)
    homes = 50 + 50j + 70 * (np.arange(9) % 3 + 1j * (np.arange(9) // 3))
    image = draw_markers(place_markers(homes, np.zeros(9), 30.0), range(9), (240, 240), rng)
    similarities = np.full(9, 30j)
    start = LocalHomographies(homes, similarities, 0 * similarities, 0 * similarities)
    return fit_markers(image, DICTIONARY, np.arange(9), start, SIGMA_PX, Plane())[0]


def test_what_is_printed_unlike_the_others_is_none(place_markers, draw_markers):
    """Of nine, one as faint as ground between cards, whatever is left of it; shade on one is none."""
    fits, fifth = nine_fits(place_markers, draw_markers), np.arange(9) == 4
    grey = replace(fits, blacks=np.where(fifth, 120.0, fits.blacks))
    grey = replace(grey, contrasts=np.where(fifth, 100.0, fits.contrasts))
    assert verified(grey, 5.0, DISTANCE).tolist() == (~fifth).tolist()
    shade = np.where(fifth, 0.4, 1.0)
    shaded = replace(fits, blacks=shade * fits.blacks, contrasts=shade * fits.contrasts)
    assert verified(shaded, 5.0, DISTANCE).all()


def test_a_white_that_no_camera_gives_is_none(place_markers, draw_markers):
    """A fit may ask for any contrast to explain a texture, where blur takes most of the texture away."""
    fits = nine_fits(place_markers, draw_markers)
    brighter = np.linspace(0, 160, 9)
    whites = fits.blacks + brighter + fits.contrasts
    assert (
        verified(replace(fits, blacks=fits.blacks + brighter), 5.0, DISTANCE).tolist()
        == (whites <= 330).tolist()
    )


@pytest.mark.parametrize(("share", "passes"), [(0.05, True), (0.2, False)])
def test_little_left_in_every_cell_is_as_bad_as_much_in_one(place_markers, draw_markers, share, passes):
    """A wrong cell leaves about 150 levels. An RMS of 13 % of the contrast of 200 is allowed over the cells:
    0.05 x 150 in every cell passes, 0.2 x 150 does not, although no cell by itself is wrong up to a fifth."""
    fits = nine_fits(place_markers, draw_markers)
    board = share * 150.0 * (-1.0) ** np.add.outer(np.arange(6), np.arange(6))
    off = replace(fits, cell_means=board + 0 * fits.cell_means)
    assert bits_are_right(off, DISTANCE).all() and (verified(off, 5.0, DISTANCE) == passes).all()


# --- large markers ---


def test_wrong_bit_residual_is_independent_of_downsampling(place_markers, draw_markers):
    """A marker of 280 px is fitted in an image of half the size: its pixels are counted in its own."""
    rng = np.random.default_rng(7)
    image = draw_markers(place_markers(200 + 200j, 0.4, 280.0), [11], (400, 400), rng)
    start = one_shape(200 + 200j, 280j * np.exp(0.4j))
    fits, _ = fit_all_sizes(image, DICTIONARY, np.array([11]), start, SIGMA_PX, Plane(), 5.0)
    whole, _ = fit_markers(image, DICTIONARY, np.array([11]), start, SIGMA_PX, Plane())
    assert fits.pixels[0] == pytest.approx(whole.pixels[0], rel=0.02)
    assert (
        verified(fits, 5.0, DISTANCE)[0]
        and not verified(replace(fits, pixels=fits.pixels / 4), 5.0, DISTANCE)[0]
    )


@pytest.mark.parametrize("shape", [(40, 37), (41, 38), (43, 39), (3, 400), (400, 3), (60, 40), (1300, 620)])
def test_noise_is_the_median_of_second_differences(shape):
    """With sorting instead of counting, of images of noise of which a part is saturated."""
    rng = np.random.default_rng(shape)
    for sigma in (2.0, 20.0, 80.0):
        image = np.clip(rng.normal(150, sigma, shape), 0, 255).astype(np.uint8)
        lines = max(4, image.size // (4 * 2**15))
        before, here, after = (image[::lines, first::4].astype(int) for first in (0, 1, 2))
        width = after.shape[1]
        usable = (here[:, :width] > 5) & (here[:, :width] < 250)
        values = np.abs(before[:, :width] - 2 * here[:, :width] + after)[usable]
        expected = np.median(values) / (0.6745 * np.sqrt(6)) if values.size >= 50 else 0
        assert image_noise(image) == pytest.approx(max(expected, ROUNDING_NOISE), rel=1e-12)
