"""The built-in missions on rendered pixels, from start to finish."""

import numpy as np
import pytest

from skyherd.analysis.history import make_history
from skyherd.analysis.summary import summarize
from skyherd.datasets import load_mission
from skyherd.loop import run_steps

THRESHOLD = {"triangle": 0.01, "star": 0.005, "grid": 0.01, "circle": 0.01}
TREES = ("chain", "tree", "failure")
LEAST_SIDE_PX = 18.0
REPAIR_S = 30.0
"""TC1 and TC2 are to be back within this time after a unit dies; an own admission counts against it too."""


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


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        ("circle", 30),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (("triangle", 70), ("star", 40), ("grid", 40))
        ),
    ],
)
def test_noisy_perception_forms_the_same_shape_and_leaves_no_robot_alone(name, seconds):
    """Points with the detector's measured noise, until the shape has been held for long enough."""
    mission = load_mission(name, ["perception=noisy", f"duration_s={seconds}"])
    history = make_history(mission, run_steps(mission))
    assert summarize(history, 1.0)["converged"]
    assert history.conditions[:, 1].all()
    assert history.commanded.all(), "controlled in fact, not in name only: each robot has a goal at all times"


def check_tree_mission(name: str, perception: str, *settings: str) -> None:
    mission = load_mission(name, [f"perception={perception}", *settings])
    history = make_history(mission, steps := list(run_steps(mission)))
    summary = summarize(history, 1.0)
    assert summary["converged"]
    assert summary["missing_robots"] == summary["unjoined_units"] == []
    has_outage = any(unit.outages for unit in mission.scenario.units)
    assert (summary["p_violation_s"] > 0) == has_outage, "only a death breaks TC1-TC5, and it does"
    assert summary["p_violation_s"] < REPAIR_S
    sides_px = np.concatenate(
        [frame.sight.detections.sides_px for step in steps for frame in step.frames.values()]
    )
    assert sides_px.min() > LEAST_SIDE_PX


@pytest.mark.slow
@pytest.mark.parametrize("name", TREES)
def test_a_tree_of_units_forms_its_shape_from_pixels_alone(name):
    check_tree_mission(name, "rendered")


@pytest.mark.slow
def test_a_unit_dies_and_returns_and_the_shape_is_formed():
    """The unit returns at 65 s, and is to be in the tree at the end."""
    check_tree_mission("failure", "noisy", "duration_s=80")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["chain", "tree"])
def test_noisy_perception_keeps_the_tree_too(name):
    check_tree_mission(name, "noisy")
