"""Sway: its amplitude, spectrum and rate, and its effect on images and ground truth."""

import numpy as np
import pytest

from skyherd.datasets import load_mission
from skyherd.loop import run_steps
from skyherd.render import project
from skyherd.sim.physics import make_world
from skyherd.sim.sway import BANDWIDTH, Sway

PERIOD_S, TILT_RAD = 3.0, 0.1


def many(count: int, times_s: np.ndarray) -> np.ndarray:
    """Return the tilts (count, T, 2) of independent units."""
    sways = (Sway.draw(TILT_RAD, PERIOD_S, np.random.default_rng([7, number])) for number in range(count))
    return np.array([[sway.tilts_rad(time) for time in times_s] for sway in sways])


def test_it_has_the_amplitude_and_the_spectrum_that_it_promises():
    """Autocorrelation over 2000 units, 4000 axes: `σ² exp(-(2π f₀ τ b)² / 2) cos(2π f₀ τ)`.

    This is the transform of the spectrum. A product of two unit normals has the deviation sqrt(1 + r²) ≤ sqrt
    2. The mean of 4000 of them has sqrt 2 / 63 = 0.022 of σ². The test allows 5 of those.
    """
    lags_s = np.array([0.0, 0.2, 0.75, 1.5, 3.0, 4.5, 9.0])
    tilts = many(2000, 11.0 + lags_s)
    found = (tilts[:, :1] * tilts).mean(axis=(0, 2)) / (TILT_RAD**2 / 2)
    phase = 2 * np.pi * lags_s / PERIOD_S
    expected = np.exp(-((BANDWIDTH * phase) ** 2) / 2) * np.cos(phase)
    np.testing.assert_allclose(found, expected, rtol=0, atol=5 * np.sqrt(2 / 4000))
    assert abs(expected[3]) > 0.5, "the noise is coloured"
    across = (tilts[:, 0, 0] * tilts[:, 0, 1]).mean() / (TILT_RAD**2 / 2)
    assert abs(across) < 5 / np.sqrt(2000), "the axes are independent"


def test_it_is_gaussian():
    """Kurtosis 3 - 3 / (2 M); for 8000 numbers its standard deviation is sqrt(24 / 8000) = 0.055."""
    tilts = many(4000, np.array([5.0])).ravel() / (TILT_RAD / np.sqrt(2))
    assert np.mean(tilts**4) == pytest.approx(3 - 1.5 / 64, abs=5 * 0.055)


def test_its_slope_is_that_of_differences():
    sway, step = Sway.draw(TILT_RAD, PERIOD_S, np.random.default_rng(1)), 1e-5
    for time in (0.0, 3.3, 57.0):
        found = (sway.tilts_rad(time + step) - sway.tilts_rad(time - step)) / (2 * step)
        np.testing.assert_allclose(sway.rates_at(time), found, rtol=0, atol=1e-8)


SWAYING = [
    "duration_s=3.0",
    "perception=ideal",
    "units.0.camera.half_angle_deg=50.0",
    "units.0.sway={ tilt_deg = 5.0, period_s = 2.0 }",
    "units.0.tilt_deg=[4.0, 0.0]",
]


def test_world_camera_sways_about_tilt_with_matching_motion():
    """Rates are compared with differences of poses, for a step near the rounding limit of times."""
    mission = load_mission("triangle", [*SWAYING, "step_s=1e-4"])
    world = make_world(mission)
    steps = run_steps(mission)
    poses = [next(steps).fleet.pose(0) for _ in range(3)]
    tilts = np.array([pose.tilt_rad for pose in poses])
    assert np.abs(tilts[0] - np.radians([4.0, 0.0])).max() > 0.01
    np.testing.assert_allclose(world.camera_pose(0).tilt_rad, tilts[0])
    at_start = world.motion(0)
    forward = (-3 * tilts[0] + 4 * tilts[1] - tilts[2]) / 2e-4
    np.testing.assert_allclose(at_start.tilt_rates_radps, forward, rtol=0, atol=1e-6)
    assert not at_start.still
    np.testing.assert_allclose(at_start.pose_at(poses[0], 1e-4).tilt_rad, tilts[1], rtol=0, atol=1e-7)


def test_detections_use_the_swayed_camera_at_every_step():
    """The reference is the projection by the recorded pose; a static camera would differ by pixels."""
    mission = load_mission("triangle", SWAYING)
    camera = make_world(mission).cameras[0]
    for step in run_steps(mission):
        seen = step.frames[0].sight.detections
        points = step.positions_m[seen.ids]
        np.testing.assert_allclose(seen.centers_px, project(camera, step.fleet.pose(0), points), atol=1e-9)
    assert np.abs(seen.centers_px - project(camera, make_world(mission).camera_pose(0), points)).max() > 5


def test_sway_is_of_the_seed_and_of_time_alone():
    """The step size and other uses of the seed do not change it; another seed does."""
    last = {}
    for name, settings in (
        ("one", []),
        ("finer", ["step_s=0.05"]),
        ("other", ["seed=2"]),
        ("second unit", ["units.0.frame_rate_hz=5.0"]),
    ):
        *_, step = run_steps(load_mission("triangle", [*SWAYING, *settings]))
        last[name] = step.fleet.tilts_rad
    np.testing.assert_allclose(last["one"], last["finer"], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(last["one"], last["second unit"])
    assert np.abs(last["one"] - last["other"]).max() > 0.01
    still, swaying = (load_mission("triangle", settings) for settings in ([], SWAYING))
    np.testing.assert_array_equal(still.positions_m, swaying.positions_m)
