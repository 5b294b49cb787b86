"""Errors of the positions that units see: of the stated size, the same for all images of an instant."""

import numpy as np
import pytest

from skyherd.datasets import load_mission
from skyherd.loop import run_steps

NOISE_M = 0.01


def steps_of(noise_m: float, perception: str = "ideal"):
    """Return the steps of robots at rest, since no goals arrive, under cameras that look straight down."""
    return run_steps(
        load_mission(
            "crowd",
            [
                f"control.told_noise_m={noise_m}",
                f"perception={perception}",
                "duration_s=4",
                "network.message_loss=0.99999",
                "units.*.flight.kind=hover",
                "units.*.height_m=8",
            ],
        )
    )


def test_seen_positions_have_stated_error() -> None:
    """An image has 16 markers; positions scale by the marker's side, 0.4 m, since the camera looks down."""
    errors_m = []
    for exact, erroneous in zip(steps_of(0.0), steps_of(NOISE_M), strict=True):
        np.testing.assert_array_equal(exact.positions_m, erroneous.positions_m)
        one, two = (step.frames[0].sight.detections for step in (exact, erroneous))
        np.testing.assert_array_equal(one.ids, two.ids)
        errors_m.append((two.centers_px - one.centers_px) / one.sides_px[:, None] * 0.4)
    errors_m = np.array(errors_m)
    draws = errors_m.size
    assert draws > 1000
    assert errors_m.std() == pytest.approx(NOISE_M, rel=4 / np.sqrt(2 * draws))
    assert abs(errors_m.mean()) < 4 * NOISE_M / np.sqrt(draws)
    between = np.mean(errors_m[1:] * errors_m[:-1])
    assert abs(between) < 4 * NOISE_M**2 / np.sqrt(draws), "each image has its own errors"


def test_error_is_common_to_images_of_one_instant() -> None:
    """Two units see the same displaced robots: a similarity maps one image onto the other exactly."""
    from skyherd.control import fit_similarity
    from skyherd.geometry import to_complex

    for step in steps_of(NOISE_M):
        one, two = (step.frames[unit].sight.detections for unit in (0, 1))
        common, first, second = np.intersect1d(one.ids, two.ids, return_indices=True)
        assert common.size > 8
        points, images = to_complex(one.centers_px[first]), to_complex(two.centers_px[second])
        assert np.abs(fit_similarity(points, images)(points) - images).max() < 1e-6
