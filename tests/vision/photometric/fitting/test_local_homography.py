"""How markers lie in an image: a homography each, moved, turned and scaled."""

import numpy as np
import pytest
from tests.helpers import homography_reference as reference

from skyherd.geometry import SQUARE_CORNERS, to_points
from skyherd.markers.dictionary import corners_of_pose
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies

COUNT = 40
POINTS = np.concatenate([SQUARE_CORNERS, [0j, 0.3 - 0.1j, 1.4 + 0.8j]])


def random_shapes(seed=0, *, horizon=1e-3, anisotropy=0.25):
    """Markers of 10-60 px a side, anisotropic and tilted at random."""
    rng = np.random.default_rng(seed)
    turn, way, toward = np.exp(2j * np.pi * rng.uniform(size=(3, COUNT)))
    similarities = rng.uniform(10, 60, COUNT) * turn
    return LocalHomographies(
        centers=rng.uniform(-400, 400, COUNT) + 1j * rng.uniform(-400, 400, COUNT),
        similarities=similarities,
        anisotropies=anisotropy * rng.uniform(size=COUNT) * np.abs(similarities) * way,
        perspectives=horizon * rng.uniform(size=COUNT) * toward,
    )


def test_axes_lead_back_from_images():
    """Marker coordinates of the images are the points themselves, to as rounding has it."""
    homographies = random_shapes()
    away = homographies.images(POINTS) - homographies.centers[:, None]
    x, y, nearness = (
        (axis.conj()[:, None] * away).real for axis in (*homographies.axes(), homographies.perspectives)
    )
    np.testing.assert_allclose((x + 1j * y) / (1 - nearness), np.tile(POINTS, (COUNT, 1)), atol=1e-12, rtol=0)


def test_an_affine_shape_is_that_of_its_corners():
    homographies = random_shapes(1, horizon=0.0)
    again = LocalHomographies.of_corners(to_points(homographies.images(SQUARE_CORNERS)))
    for name in ("centers", "similarities", "anisotropies", "perspectives"):
        np.testing.assert_allclose(getattr(again, name), getattr(homographies, name), atol=1e-10, rtol=0)


def test_squares_have_their_own_headings_and_sides():
    rng = np.random.default_rng(2)
    centers, headings, sides = (
        rng.uniform(0, 900, (30, 2)),
        rng.uniform(-3.1, 3.1, 30),
        rng.uniform(8, 90, 30),
    )
    homographies = LocalHomographies.of_corners(corners_of_pose(centers, headings, sides))
    np.testing.assert_allclose(homographies.headings_rad(), headings, atol=1e-12)
    np.testing.assert_allclose(homographies.sides_px(), sides, rtol=1e-12)
    np.testing.assert_allclose(homographies.anisotropies, 0, atol=1e-11)


def test_heading_and_side_match_the_jacobian_at_the_centre():
    """Forward and scale by central differences: of order h², here (1e-4 x 60 x 1e-3)² of themselves."""
    homographies, h = random_shapes(3), 1e-4
    right, down = (
        (homographies.images(np.array([s]) * h) - homographies.images(np.array([-s]) * h))[:, 0]
        for s in (1, 1j)
    )
    np.testing.assert_allclose(np.angle(-down / np.exp(1j * homographies.headings_rad())), 0, atol=1e-8)
    area = (right.conj() * down).imag / (2 * h) ** 2
    np.testing.assert_allclose(np.sqrt(area), homographies.sides_px(), rtol=1e-8)


def steps(seed, size):
    rng = np.random.default_rng(seed)
    return size * (rng.normal(size=(3, COUNT)) + 1j * rng.normal(size=(3, COUNT)))


STILL = np.zeros(COUNT, dtype=complex)


def after(homographies, shift, grow, anisotropy):
    """Images of `POINTS` taken through the step in marker coordinates first: the composition itself."""
    stepped = shift[:, None] + (1 + grow)[:, None] * POINTS + anisotropy[:, None] * POINTS.conj()
    return np.array([homographies.take(np.array([row])).images(z)[0] for row, z in enumerate(stepped)])


def test_affine_shapes_move_exactly():
    """An affine map after an affine map is one: nothing is left to a second order, however large the step."""
    homographies, step = random_shapes(4, horizon=0.0), steps(4, 0.3)
    np.testing.assert_allclose(
        reference.moved(homographies, *step, STILL).images(POINTS), after(homographies, *step), atol=1e-9
    )


def test_growth_and_anisotropy_are_exact_with_perspective():
    homographies, (_, grow, anisotropy) = random_shapes(5), steps(5, 0.1)
    moved = reference.moved(homographies, STILL, grow, anisotropy, STILL)
    np.testing.assert_allclose(moved.images(POINTS), after(homographies, STILL, grow, anisotropy), atol=1e-9)


def test_a_keystone_changes_the_perspective_exactly():
    """A point z of the changed marker lies where `z / (1 + Re(q̄ z))` lay; `keystones_to` goes back."""
    homographies, (keystone, *_) = random_shapes(8), steps(8, 0.05)
    moved = reference.moved(homographies, STILL, STILL, STILL, keystone)
    nearer = POINTS / (1 + (keystone.conj()[:, None] * POINTS).real)
    before = [homographies.take(np.array([row])).images(z)[0] for row, z in enumerate(nearer)]
    np.testing.assert_allclose(moved.images(POINTS), before, atol=1e-9)
    np.testing.assert_allclose(reference.keystones_to(homographies, moved.perspectives), keystone, atol=1e-12)


def test_marker_blur_is_image_blur_under_the_inverse_map():
    """Its covariance `σ² (JᵀJ)⁻¹`, whose mean variance and anisotropy the two methods give."""
    homographies, sigma_px = random_shapes(9), 0.8
    across, down = homographies.axes()
    inverse = np.stack([[across.real, across.imag], [down.real, down.imag]]).transpose(2, 0, 1)
    covariances = sigma_px**2 * inverse @ inverse.transpose(0, 2, 1)
    squares, uneven = homographies.blurs(sigma_px) ** 2, reference.blur_anisotropies(homographies)
    np.testing.assert_allclose(covariances[:, 0, 0], squares * (1 - 2 * uneven.real))
    np.testing.assert_allclose(covariances[:, 1, 1], squares * (1 + 2 * uneven.real))
    np.testing.assert_allclose(covariances[:, 0, 1], -2 * squares * uneven.imag, atol=1e-12)


def test_shift_error_under_perspective_is_of_second_order():
    """Order 2, recovered over four halvings of shift and horizon together."""
    errors, scales = [], 0.5 ** np.arange(5)
    for scale in scales:
        homographies, step = random_shapes(6, horizon=1e-3 * scale), steps(6, 0.1 * scale)
        moved = reference.moved(homographies, *step, STILL)
        errors.append(np.abs(moved.images(POINTS) - after(homographies, *step)).max())
    order = np.polyfit(np.log(scales), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.1), errors


@pytest.mark.parametrize("factor", [2, 4, 8])
def test_shrunk_shapes_match_shrunk_pixels_and_invert(factor):
    """Pixel j of a shrunk image is the mean of pixels factor j to factor j + factor - 1."""
    homographies = random_shapes(7)
    small = homographies.scaled(factor)
    middle = (factor - 1) / 2 * (1 + 1j)
    np.testing.assert_allclose(small.images(POINTS) * factor + middle, homographies.images(POINTS), atol=1e-9)
    back = small.scaled(1 / factor)
    for name in ("centers", "similarities", "anisotropies", "perspectives"):
        np.testing.assert_allclose(getattr(back, name), getattr(homographies, name), rtol=1e-12, atol=1e-12)


def test_replacing_some_leaves_the_others():
    homographies, others = random_shapes(8), random_shapes(9)
    rows = np.array([0, 5, 39])
    mixed = homographies.put(rows, others.take(rows))
    kept = np.setdiff1d(np.arange(COUNT), rows)
    np.testing.assert_array_equal(mixed.centers[rows], others.centers[rows])
    np.testing.assert_array_equal(mixed.perspectives[kept], homographies.perspectives[kept])
    assert len(mixed) == COUNT and len(homographies.take(rows).joined(others)) == COUNT + 3
