"""Defocus and coma: their formulas, moments, and that the cubature over the pupil is fine enough."""

import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.render import Camera, CameraPose, Ground, LensBlur, Renderer, Sensor, Shot
from skyherd.render.camera import lens_blur
from skyherd.render.camera.camera import footprint_m, rotation_camera_world

CAMERA = Camera((160, 120), 160.0, aspect=1.05)
LEVEL = CameraPose((0.3, -0.2), 6.0, 0.4)
TILTED = CameraPose((0.3, -0.2), 6.0, 0.4, (np.radians(20.0), np.radians(-8.0)))
TEAM = np.arange(4), np.array([[1.2, 0.9], [-1.3, 0.9], [-1.2, -1.1], [1.4, -1.0]]), np.linspace(-2, 3, 4)


def light(blur: LensBlur, pose: CameraPose = LEVEL, psf_px: float = 0.5, team=TEAM) -> np.ndarray:
    """Light of four markers on even ground, as floats."""
    ground, sensor = Ground(0, contrast=0.0), Sensor(0.0, np.random.default_rng(0))
    renderer = Renderer("4X4_50", 1.0, ground, sensor, psf_px=psf_px, lens_blur=blur)
    return renderer.light(Shot(CAMERA, pose, *team)).astype(float)


def moments(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (2,) and covariance (2, 2) of an image's light, taken as a density."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    share = image.ravel().astype(float) / image.sum(dtype=float)
    at = np.stack([u.ravel(), v.ravel()])
    mean = at @ share
    return mean, (at - mean[:, None]) * share @ (at - mean[:, None]).T


@pytest.mark.parametrize(
    "blur", [LensBlur(disc_px=2.5), LensBlur(coma_px=0.8, coma_rad=0.6), LensBlur(1.5, 0.5, -2.0)]
)
def test_an_image_gets_the_moments_of_disc_and_coma(blur):
    """Variances of a convolution add up: disc r²/4 a side, coma C²/2 along and C²/6 across; the mean stays.

    A bright square in the dark. Sampling a Gaussian of 0.85 px leaves exp(-2 π² 0.85²) of its moments, 1e-6.
    """
    one, dark = (TEAM[0][:1], np.array([[0.3, -0.2]]), TEAM[2][:1]), Ground(0, mean=0, contrast=0)
    sensor, grey = Sensor(0.0, np.random.default_rng(0)), {"black": 200.0, "white": 200.0}
    (sharp_mean, sharp), (mean, blurred) = (
        moments(Renderer("4X4_50", 1.0, dark, sensor, **grey, lens_blur=b).light(Shot(CAMERA, LEVEL, *one)))
        for b in (LensBlur(), blur)
    )
    along = np.array([np.cos(blur.coma_rad), np.sin(blur.coma_rad)])
    across = np.array([-along[1], along[0]])
    spread = blur.coma_px**2 * (np.outer(along, along) / 2 + np.outer(across, across) / 6)
    np.testing.assert_allclose(mean, sharp_mean, atol=1e-3)
    np.testing.assert_allclose(blurred - sharp, blur.disc_px**2 / 4 * np.eye(2) + spread, atol=5e-3)
    assert blur.variances_px2(CAMERA, LEVEL, np.zeros((1, 2)))[0] == pytest.approx(
        (blur.disc_px**2 / 2 + np.trace(spread)) / 2
    )


def test_a_disc_is_the_sharp_image_convolved_with_a_disc():
    """At four times the resolution a disc of 0s and 1s, then means of 4 x 4: another way to the image."""
    radius, times = 2.0, 4
    fine = Camera((160 * times, 120 * times), 160.0 * times, aspect=1.05)
    ground, sensor = Ground(0, contrast=0.0), Sensor(0.0, np.random.default_rng(0))
    sharp = Renderer("4X4_50", 1.0, ground, sensor, psf_px=0.5 * times).light(Shot(fine, LEVEL, *TEAM))
    reach = int(radius * times) + 1
    steps = (np.arange((2 * reach + 1) * 16) + 0.5) / 16 - reach - 0.5
    inside = (steps[:, None] ** 2 + steps**2 < (radius * times) ** 2).astype(float)
    kernel = inside.reshape(2 * reach + 1, 16, 2 * reach + 1, 16).mean(axis=(1, 3))
    spectrum = np.fft.rfft2(kernel / kernel.sum(), sharp.shape) * np.fft.rfft2(sharp)
    around = np.roll(np.fft.irfft2(spectrum, sharp.shape), (-reach, -reach), axis=(0, 1))
    expected = around.reshape(120, times, 160, times).mean(axis=(1, 3))
    inner = (slice(6, -6), slice(6, -6))
    assert np.abs(light(LensBlur(disc_px=radius)) - expected)[inner].max() < 0.5
    assert np.abs(light(LensBlur()) - expected)[inner].max() > 20, "the negative control"


@pytest.mark.parametrize(
    "blur",
    [
        LensBlur(disc_px=1.0),
        LensBlur(disc_px=2.0),
        LensBlur(coma_px=0.5),
        LensBlur(aperture_m=0.1, focus_m=5),
    ],
)
def test_more_rays_change_nothing(blur, monkeypatch):
    """The statement of the constants: 0.3 grey levels of 200 at most, 0.03 in the root mean square."""
    one = tuple(part[:1] for part in TEAM)
    asked = light(blur, TILTED, team=one)
    for name in ("RADIAL", "ANGULAR"):
        monkeypatch.setattr(lens_blur, f"{name}_PER_SIGMA", 3 * getattr(lens_blur, f"{name}_PER_SIGMA"))
        monkeypatch.setattr(lens_blur, f"{name}_LEAST", 3 * getattr(lens_blur, f"{name}_LEAST"))
    away = asked - light(blur, TILTED, team=one)
    assert np.abs(away).max() < 0.3 and np.sqrt((away**2).mean()) < 0.03


def test_inverse_distance_is_that_of_the_ground_at_each_pixel():
    corners = np.array([*footprint_m(CAMERA, TILTED).T, np.zeros(4)]).T
    camera = np.array([*TILTED.position_m, TILTED.height_m])
    distances = (corners - camera) @ rotation_camera_world(TILTED)[2]
    found = lens_blur.inverse_depths(CAMERA, TILTED, CAMERA.corners_px)
    np.testing.assert_allclose(1 / found, distances, rtol=1e-12)


def test_the_disc_by_depth_is_that_of_a_thin_lens():
    """A lens of focal length F focused at z_f has its sensor at v_f = F z_f / (z_f - F).

    A point at z is sharp at v = F z / (z - F), so that its cone, A wide at the lens, is A |v - v_f| / v wide
    on the sensor; f px are v_f long.
    """
    thin_m, focus_m, aperture_m = 0.05, 5.0, 0.02
    corners = CAMERA.corners_px
    z = 1 / lens_blur.inverse_depths(CAMERA, TILTED, corners)
    sensor_m, sharp_m = thin_m * focus_m / (focus_m - thin_m), thin_m * z / (z - thin_m)
    diameter_m = aperture_m * (sensor_m - sharp_m) / sharp_m
    blur = LensBlur(aperture_m=aperture_m, focus_m=focus_m)
    expected = CAMERA.focal_px * diameter_m / 2 / sensor_m
    np.testing.assert_allclose(blur.radii_px(CAMERA, TILTED, corners), expected, rtol=1e-9)


def test_each_ray_sees_as_a_pinhole_at_its_place_in_the_lens():
    """A camera moved by a in its image plane and shifted so that the plane in focus stays: the same image."""
    blur = LensBlur(aperture_m=0.4, focus_m=5.5)
    rotation = rotation_camera_world(TILTED)
    for ray in blur.rays(CAMERA, TILTED, 0.6)[::5]:
        moved = ray.parallax_px_m / (CAMERA.focal_px * np.array([1.0, CAMERA.aspect]))
        center = np.array([*TILTED.position_m, TILTED.height_m]) + rotation[:2].T @ moved
        matrix = CAMERA.intrinsic_matrix() @ np.column_stack([rotation[:, :2], -rotation @ center])
        matrix[:2] += np.outer(ray.shift_px, matrix[2])
        found = ray.homography(CAMERA, TILTED)
        np.testing.assert_allclose(found / found[2, 2], matrix / matrix[2, 2], rtol=1e-9, atol=1e-9)


def test_what_is_in_focus_is_sharp_and_what_is_not_is_a_disc():
    """Seen from straight above all ground has one distance; 6 m in focus, or 5 m, whose disc is 2 px."""
    sharp = light(LensBlur())
    np.testing.assert_allclose(light(LensBlur(aperture_m=0.5, focus_m=6.0)), sharp, atol=1e-3)
    aperture_m = 2 * 2.0 / (160 * (1 / 5.0 - 1 / 6.0))
    square = Camera((160, 120), 160.0)
    images = [
        Renderer("4X4_50", 1.0, Ground(0, contrast=0.0), Sensor(0, np.random.default_rng(0)), lens_blur=b)
        for b in (LensBlur(aperture_m=aperture_m, focus_m=5.0), LensBlur(disc_px=2.0))
    ]
    one, other = (renderer.light(Shot(square, LEVEL, *TEAM)) for renderer in images)
    np.testing.assert_allclose(one, other, atol=1e-2)


def test_rays_share_the_light_and_shift_nothing_in_the_mean():
    rays = LensBlur(2.0, 0.7, 0.3, 0.2, 5.0).rays(CAMERA, TILTED, 0.6)
    weights = np.array([ray.weight for ray in rays])
    assert weights.sum() == pytest.approx(1.0) and weights.min() > 0
    np.testing.assert_allclose(weights @ np.array([ray.shift_px for ray in rays]), 0.0, atol=1e-12)


def test_a_lens_blur_that_cannot_be_is_refused():
    for wrong in ({"disc_px": -1.0}, {"coma_px": -0.1}, {"aperture_m": -1.0}, {"focus_m": 0.0}):
        with pytest.raises(InputError, match="lens"):
            LensBlur(**wrong)


def test_off_it_changes_no_bit():
    plain, off = (
        Renderer(
            "4X4_50", 1.0, Ground(3, kind="tiles", tile_m=0.7), Sensor(2.0, np.random.default_rng(1)), **lens
        )
        for lens in ({}, {"lens_blur": LensBlur(coma_rad=1.0, focus_m=3.0)})
    )
    shot = Shot(CAMERA, TILTED, *TEAM)
    np.testing.assert_array_equal(plain.render(shot), off.render(shot))
    np.testing.assert_array_equal(plain.light(shot), off.light(shot))
