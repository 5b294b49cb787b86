"""The sensor: each part of its law, and that it is off at its neutral value."""

import cv2
import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.render import Illumination, Sensor


def exposed(light: float | np.ndarray, size=(400, 400), seed=1, noise=0.0, **parts) -> np.ndarray:
    """Image of even light, or of light given, as floats."""
    scene = np.full(size, light, np.float32) if np.isscalar(light) else light.astype(np.float32)
    return Sensor(noise, np.random.default_rng(seed), **parts).expose(scene).astype(float)


def test_noise_is_white_gaussian_and_of_the_stated_size() -> None:
    """160 000 pixels; rounding adds 1/12 twice at most (bank and image); 5 standard errors of a deviation."""
    image = np.full((400, 400), 128, np.uint8)
    noise = Sensor(3.0, np.random.default_rng(1)).expose(image.copy()).astype(float) - 128
    assert noise.mean() == pytest.approx(0.0, abs=5 * 3 / 400)
    assert noise.std() == pytest.approx(np.sqrt(9 + 1 / 12), rel=5 / np.sqrt(2 * 160_000))
    for shift in ((0, 1), (1, 0), (1, 1)):
        neighbor = np.roll(noise, shift, axis=(0, 1))
        assert np.corrcoef(noise.ravel(), neighbor.ravel())[0, 1] == pytest.approx(0.0, abs=5 / 400)


def test_noise_differs_between_frames_and_saturates() -> None:
    sensor = Sensor(5.0, np.random.default_rng(1))
    one, two = (sensor.expose(np.full((100, 100), 128, np.uint8)).astype(float) for _ in range(2))
    assert abs(np.corrcoef(one.ravel(), two.ravel())[0, 1]) < 5 / 100
    assert sensor.expose(np.full((100, 100), 255, np.uint8)).min() > 200
    assert sensor.expose(np.full((100, 100), 0, np.uint8)).max() < 55


def test_shot_noise_grows_with_the_signal():
    """Variance `noise² + shot s`, and 1/12 of rounding; 5 standard errors, of 160 000 pixels."""
    for level in (20.0, 100.0, 200.0):
        variance = exposed(level, noise=1.5, shot=0.2).var()
        expected = 1.5**2 + 0.2 * level + 1 / 12
        assert variance == pytest.approx(expected, rel=5 * np.sqrt(2 / 160_000))


def test_gain_multiplies_and_saturates():
    np.testing.assert_array_equal(exposed(60.0, gain=2.0), 120.0)
    np.testing.assert_array_equal(exposed(200.0, gain=2.0), 255.0)


def test_vignetting_darkens_the_corners_by_its_share():
    factor = Illumination(vignetting=0.4).of((641, 481))
    assert factor[240, 320] == 1.0
    assert factor[0, 0] == pytest.approx(0.6, abs=0.4 * 2 * 2 / 481), (
        "a pixel's centre is half a pixel inside"
    )
    np.testing.assert_allclose(factor, factor[::-1, ::-1], atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, np.pi / 2, 0.7, -2.0])
def test_the_gradient_runs_from_border_to_border(angle):
    """Linear, one in the middle, and 0.3 more light at the far border (corner) than at the near one."""
    factor = Illumination(gradient=0.3, gradient_rad=angle).of((641, 481)).astype(float)
    assert factor[240, 320] == pytest.approx(1.0, abs=1e-6)
    assert factor.max() - factor.min() == pytest.approx(0.3, abs=0.3 * 2 / 481)
    v, u = np.unravel_index(factor.argmax(), factor.shape)
    assert (u - 320) * np.cos(angle) + (v - 240) * np.sin(angle) > 0
    assert np.abs(np.diff(factor, n=2, axis=0)).max() < 1e-6
    assert np.abs(np.diff(factor, n=2, axis=1)).max() < 1e-6


def test_the_shadow_has_depth_place_side_and_softness():
    """Edge 0.5 of the half shorter side right of the middle: pixel 320 + 120; 0.1 soft: 24 px a sigma."""
    factor = Illumination(shadow=0.6, shadow_offset=0.5, shadow_edge=0.1).of((641, 481))[100]
    assert factor[0] == pytest.approx(1.0, abs=1e-3)
    assert factor[-1] == pytest.approx(0.4, abs=1e-3)
    assert np.interp(440.25, np.arange(641), factor) == pytest.approx(0.7, abs=1e-3)
    assert np.interp(440.25 - 24.05, np.arange(641), factor) == pytest.approx(1 - 0.6 * 0.1587, abs=1e-3)


def test_a_jpeg_is_opencvs_of_that_quality():
    image = np.random.default_rng(3).integers(0, 256, (64, 80), dtype=np.uint8)
    expected = cv2.imdecode(
        cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 60])[1], cv2.IMREAD_GRAYSCALE
    )
    np.testing.assert_array_equal(exposed(image, jpeg_quality=60), expected)
    with pytest.raises(InputError, match="jpeg_quality: 0"):
        Sensor(0.0, np.random.default_rng(0), jpeg_quality=0)


@pytest.mark.parametrize(
    "off",
    [
        {"shot": 0.0},
        {"gain": 1.0},
        {"jpeg_quality": None},
        {
            "illumination": Illumination(
                vignetting=0.0, gradient=0.0, gradient_rad=1.0, shadow=0.0, shadow_offset=1.0
            )
        },
    ],
)
def test_every_part_is_off_at_its_neutral_value(off):
    """Then the image is the same, bit by bit; all at other values it is not."""
    ramp = np.add.outer(np.arange(60.0), 2 * np.arange(80.0))
    plain = exposed(ramp, noise=2.0)
    np.testing.assert_array_equal(exposed(ramp, noise=2.0, **off), plain)
    on = exposed(ramp, noise=2.0, shot=0.1, gain=1.1, illumination=Illumination(0.1, 0.1), jpeg_quality=50)
    assert (on != plain).mean() > 0.5
