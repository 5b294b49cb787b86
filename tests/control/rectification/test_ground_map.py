"""The map to the ground against projective geometry, lenses and finite differences."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from seen_squares import FOCAL_PX, View, random_robots

from skyherd.control import GroundMap
from skyherd.control.rectification.ground_map import (
    ANISOTROPY,
    LENS,
    PERSPECTIVE,
    UNKNOWNS,
    USUAL_FOCAL,
    local_maps,
)
from skyherd.control.rectification.square_shapes import log_sides, relative_anisotropies
from skyherd.geometry import fit_squares
from skyherd.render import Camera, Distortion
from skyherd.render.camera.camera import rotation_camera_world

POINTS = np.random.default_rng(0).uniform(-0.7, 0.7, (2, 20)).T @ np.array([1, 1j])


def random_unknowns(seed: int) -> np.ndarray:
    scale = [0.1, 0.1, 0.15, 0.05, 0.05, 0.1, 0.1, 0.3, 0.15, 0.15]
    return scale * np.random.default_rng(seed).standard_normal(UNKNOWNS)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("way", [1.0, 1j, np.exp(2j)])
def test_map_derivatives_match_finite_differences(seed, way):
    """Central differences of step h leave h² = 1e-10 times third derivatives, and rounding of 1e-16 / h."""
    unknowns, h = random_unknowns(seed), 1e-5
    maps = local_maps(unknowns, POINTS)
    ahead, behind = (local_maps(unknowns, POINTS + s * h * way).values for s in (1, -1))
    predicted = maps.derivatives * way + maps.conjugate_derivatives * np.conj(way)
    np.testing.assert_allclose((ahead - behind) / (2 * h), predicted, atol=1e-7, rtol=0)


@pytest.mark.parametrize("seed", range(6))
def test_map_fixes_center_and_circle_radius(seed):
    unknowns = random_unknowns(seed)
    origin = local_maps(unknowns, np.zeros(1, dtype=complex))
    assert abs(origin.values[0]) < 1e-15
    assert origin.derivatives[0].real > 0
    assert abs(origin.derivatives[0].imag) < 1e-15
    circle = local_maps(unknowns, np.array([1, 1j, -1, -1j]))
    assert np.abs(circle.values).mean() == pytest.approx(1.0, abs=1e-14)


def true_unknowns(view: View) -> np.ndarray:
    """Return α, f and λ from the camera's matrix and its rotation.

    With `p = A z + B z̄` from rays z to points, α = B / Ā and f = |A|. The ground's rays have no component
    along its normal n. That is the horizon's line `Re(λ̄_z z) = 1` with λ_z = -(n_x + i n_y) / n_z, and λ =
    λ_z / Ā.
    """
    half = view.camera.size_px[0] / 2
    f, aspect, skew = view.camera.focal_px * view.zoom / half, view.camera.aspect, view.camera.skew
    a, b = f * (1 + aspect - 1j * skew) / 2, f * (1 - aspect + 1j * skew) / 2
    squeeze = b / np.conj(a)
    x, y, z = rotation_camera_world(view.pose)[:, 2]
    horizon = -complex(x, y) / z / np.conj(a)
    unknowns = np.zeros(UNKNOWNS)
    unknowns[ANISOTROPY], unknowns[PERSPECTIVE] = (squeeze.real, squeeze.imag), (horizon.real, horizon.imag)
    unknowns[7] = (abs(a) / USUAL_FOCAL) ** 2 - 1
    return unknowns


@pytest.mark.parametrize("tilt_deg", [(0.0, 0.0), (12.0, -9.0), (-25.0, 3.0)])
@pytest.mark.parametrize(("aspect", "skew"), [(1.0, 0.0), (0.75, 0.0), (1.2, -0.1)])
def test_map_with_true_unknowns_equals_camera_projection(tilt_deg, aspect, skew):
    """Both sides are exact projective geometry; the reference's own finite differences leave 1e-6 px."""
    view = View(Camera((800, 800), FOCAL_PX, aspect=aspect, skew=skew), tilt_deg)
    image_px = 400 * np.column_stack([POINTS.real, POINTS.imag]) + 399.5
    ours = GroundMap(true_unknowns(view)).rectified_px(image_px, np.array([800, 800]))
    np.testing.assert_allclose(ours, view.ideal_px(image_px), atol=1e-5, rtol=0)


def test_square_images_match_predicted_anisotropy_and_size():
    """For small squares the corners' affine part leaves the third derivative times the side squared, 1e-6."""
    view = View(Camera((800, 800), FOCAL_PX, aspect=1.2, skew=0.05), (10.0, -6.0), sigma_px=0.0)
    rng = np.random.default_rng(1)
    positions, headings = random_robots(rng, 12)
    seen = view.see(positions, headings, rng)
    points = ((seen.centers_px - 399.5) / 400) @ np.array([1, 1j])
    maps = local_maps(true_unknowns(view), points)
    corners = ((seen.corners_px - 399.5) / 400) @ np.array([1, 1j])
    squares = fit_squares(corners)
    assert np.abs(relative_anisotropies(squares)).max() > 0.05
    np.testing.assert_allclose(relative_anisotropies(squares), maps.anisotropies(), atol=2e-4, rtol=0)
    sides = log_sides(squares) - maps.log_scales()
    np.testing.assert_allclose(sides, sides.mean(), atol=5e-4, rtol=0)


@pytest.mark.parametrize("seed", range(6))
def test_map_inverse_recovers_points(seed):
    """Newton's method is quadratic: the error is the rounding of 1e3 px."""
    ground_map, size = GroundMap(random_unknowns(seed)), np.array([800, 600])
    points_px = np.random.default_rng(seed).uniform(100, 500, (30, 2))
    there = ground_map.rectified_px(points_px, size)
    assert np.abs(there - points_px).max() > 1.0
    np.testing.assert_allclose(ground_map.image_px(there, size), points_px, atol=1e-9, rtol=0)


def test_map_without_unknowns_is_identity():
    assert GroundMap().ideal
    points_px = np.random.default_rng(0).uniform(0, 800, (30, 2))
    np.testing.assert_allclose(
        GroundMap().rectified_px(points_px, np.array([800, 800])), points_px, atol=1e-10, rtol=0
    )


BROWN = [
    (lambda r, k1=k1: Distortion(k1=k1).apply(np.column_stack([r, 0 * r]))[:, 0], 0.7, f"Brown k1 = {k1:g}")
    for k1 in (-0.25, 0.1)
]


@pytest.mark.parametrize(
    ("lens", "reach", "name"),
    [
        *BROWN,
        (np.arctan, np.tan(np.radians(60)), "equidistant"),
        (lambda r: np.sin(np.arctan(r) / 2), np.tan(np.radians(60)), "equisolid"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_three_lens_coefficients_fit_all_lens_models(lens, reach, name):
    """A fit of κ to the lens's own curve leaves at most 2e-4 of the image's radius.

    One coefficient leaves at least five times as much.
    """
    rays = np.linspace(0.01, reach, 200)
    seen = lens(rays)
    radius = seen / seen.max()

    def left(x: np.ndarray) -> np.ndarray:
        unknowns = np.zeros(UNKNOWNS)
        unknowns[LENS[: x.size - 1]] = x[1:]
        values = local_maps(unknowns, radius.astype(complex)).values.real
        return x[0] * values - rays / reach

    one, three = (
        np.abs(least_squares(left, np.r_[1.0, np.zeros(n)], xtol=1e-14, ftol=1e-14).fun).max() for n in (1, 3)
    )
    assert three < 2e-4
    assert one > 5 * three


def test_focal_length_stays_positive_with_nonzero_slope():
    """The map depends on the unknown at any value: an unknown without slope would seem to be certain."""
    points = np.array([0.3 + 0.1j, -0.2 + 0.4j])
    for focal in (-3.0, -1.0, -0.95, -0.5, 0.0, 2.0):
        unknowns = np.zeros(UNKNOWNS)
        unknowns[PERSPECTIVE], unknowns[7] = (0.1, -0.05), focal
        step = np.zeros(UNKNOWNS)
        step[7] = 1e-4
        up, down = (local_maps(unknowns + sign * step, points) for sign in (1, -1))
        assert np.isfinite(up.values).all()
        assert np.abs(up.anisotropies() - down.anisotropies()).max() > 1e-10
    below, above = (local_maps(np.r_[np.zeros(7), f, 0.1, -0.05], points) for f in (-0.5 - 1e-9, -0.5 + 1e-9))
    np.testing.assert_allclose(below.values, above.values, atol=1e-10)
