"""Requirements on the built-in missions, from start to finish, for any duration and frame rate."""

import numpy as np

from skyherd.analysis.history import make_history
from skyherd.analysis.summary import summarize
from skyherd.datasets import load_mission
from skyherd.loop import run_steps

THRESHOLD = {"triangle": 0.01, "star": 0.005, "grid": 0.01, "circle": 0.01}
TREES = ("chain", "tree", "failure")
MIN_SIDE_PX = 18.0
REPAIR_S = 30.0
"""Time in which TC1 and TC2 must recover after a unit's death, s; an admission counts as well. Chosen."""


def check_mission_from_pixels(name: str, *settings: str) -> None:
    """Check that the shape is formed, and that every robot is controlled and commanded throughout."""
    mission = load_mission(name, list(settings))
    history = make_history(mission, run_steps(mission))
    summary = summarize(history, 1.0)
    assert history.shape_error[0] > 0.3
    assert history.controlled[0].any(axis=0).all(), "every robot is controlled from the first frame on"
    assert summary["tc2_violation_s"] == summary["uncommanded_robot_s"] == 0
    assert summary["converged"]
    assert summary["shape_error"] < THRESHOLD[name]
    assert summary["detection_recall"] > 0.98


def check_noisy_mission(name: str, *settings: str) -> None:
    """Check the same on points with the detector's measured noise."""
    mission = load_mission(name, ["perception=noisy", *settings])
    history = make_history(mission, run_steps(mission))
    assert summarize(history, 1.0)["converged"]
    assert history.conditions[:, 1].all()
    assert history.commanded.all(), "controlled in fact, not in name only: each robot has a goal at all times"


def check_tree_mission(name: str, perception: str, *settings: str) -> None:
    """Check that a tree of units forms the shape, and that only a unit's death breaks TC1-TC5."""
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
    assert sides_px.min() > MIN_SIDE_PX
