"""The built-in missions on rendered pixels, from start to finish."""

import pytest

from skyherd.datasets import load_mission
from skyherd.history import make_history
from skyherd.loop import run_steps
from skyherd.summary import summarize

THRESHOLD = {"triangle": 0.01, "star": 0.005, "grid": 0.01, "circle": 0.01}


@pytest.mark.slow
@pytest.mark.parametrize("name", THRESHOLD)
def test_a_mission_forms_its_shape_from_pixels_alone(name):
    history = make_history(load_mission(name), run_steps(load_mission(name)))
    summary = summarize(history, 1.0)
    assert history.shape_error[0] > 0.3
    assert history.controlled[0].any(axis=0).all(), "every robot is controlled from the first frame on"
    assert summary["tc2_violation_s"] == summary["uncommanded_robot_s"] == 0
    assert summary["converged"]
    assert summary["shape_error"] < THRESHOLD[name]
    assert summary["detection_recall"] > 0.98


@pytest.mark.parametrize("name", THRESHOLD)
def test_noisy_perception_forms_the_same_shape_and_leaves_no_robot_alone(name):
    """Points with the detector's measured noise: seconds, where pixels take minutes."""
    mission = load_mission(name, ["perception=noisy"])
    history = make_history(mission, run_steps(mission))
    assert summarize(history, 1.0)["converged"]
    assert history.conditions[:, 1].all()
    assert history.commanded.all(), "controlled in fact, not in name only: each robot has a goal at all times"
