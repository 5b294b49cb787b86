"""The built-in missions on rendered pixels, from start to finish, with fewer images.

`test_missions_at_length` has the full versions with all images.
"""

import pytest
from mission_checks import check_mission_from_pixels, check_noisy_mission, check_tree_mission

FEWER_IMAGES = ["step_s=0.2", "units.*.frame_rate_hz=2.5"]
"""A quarter of the images, 0.4 s apart: within the 0.5 s of the goal timeout."""

FORMED_S = {"triangle": 22, "star": 36, "grid": 34, "circle": 26}
"""Time at which each shape has been held for the goal's 5 s plus a margin."""

SETTINGS = {name: [*FEWER_IMAGES, f"duration_s={seconds}"] for name, seconds in FORMED_S.items()}
SETTINGS["triangle"] += ["control.k=0.3", "control.k_omega=1.2"]

TREE_SETTINGS = {
    "chain": ["units.*.frame_rate_hz=2.5", "duration_s=45", "goal.shape_error=0.03"],
    "tree": ["units.*.frame_rate_hz=2.5", "duration_s=62"],
    "failure": ["units.*.frame_rate_hz=2.5", "duration_s=76"],
}
"""Half of the images. `chain`, the slowest, approaches 1 %; the failed unit returns at 65 s."""


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMED_S)
def test_mission_forms_shape_from_pixels(name):
    check_mission_from_pixels(name, *SETTINGS[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", TREE_SETTINGS)
def test_tree_mission_forms_shape_from_pixels(name):
    check_tree_mission(name, "rendered", *TREE_SETTINGS[name])


@pytest.mark.parametrize(
    "name", ["star", "grid", *(pytest.param(name, marks=pytest.mark.slow) for name in ("triangle", "circle"))]
)
def test_noisy_mission_forms_shape_with_all_robots(name):
    """Points with the detector's measured noise."""
    check_noisy_mission(name, *SETTINGS[name])
