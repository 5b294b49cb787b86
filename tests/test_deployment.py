"""Before the tree is complete: units hold their place while it grows, and look around where it does not."""

from typing import Any

import numpy as np
import pytest

from skyherd.datasets import make_mission
from skyherd.datasets.random_missions import random_mission
from skyherd.loop import Step, run_steps


def is_ready(step: Step) -> bool:
    return any(frame.decision.report.tree.ready for frame in step.frames.values())


def until_ready(tree: dict[str, Any], limit_s: float) -> list[Step]:
    steps = []
    for step in run_steps(make_mission(tree | {"perception": "ideal"})):
        steps.append(step)
        if is_ready(step) or step.time_s > limit_s:
            break
    return steps


@pytest.mark.parametrize("seed", [0, 3])
def test_units_hold_their_place_while_the_tree_grows(seed) -> None:
    """It grows in every slot of these two missions; then units move to where their sets want them."""
    mission = random_mission(seed)
    *before, at_once = until_ready(mission, 20.0)
    assert is_ready(at_once)
    for step in before:
        np.testing.assert_array_equal(step.fleet.heights_m, before[0].fleet.heights_m)
        np.testing.assert_array_equal(step.fleet.positions_m, before[0].fleet.positions_m)
    commands = [frame.decision.flight for frame in at_once.frames.values()]
    assert any(command.climb_mps or command.lateral_mps.any() for command in commands)


def test_units_that_share_no_robots_climb_until_they_do() -> None:
    """No unit can ask any other; after two slots they look around, and find each other."""
    tree = random_mission(0)
    for unit in tree["units"]:
        unit["height_m"] = 0.5 * unit["height_m"]
    steps = until_ready(tree, 40.0)
    seen = [set(frame.sight.detections.ids.tolist()) for frame in steps[0].frames.values()]
    assert len(set.intersection(*seen)) < 2
    heights = np.array([step.fleet.heights_m for step in steps])
    still = np.flatnonzero((heights == heights[0]).all(axis=1))
    assert steps[still[-1]].time_s >= 4.0, "a dwell time to wait for others, and one without growth"
    assert is_ready(steps[-1]) and (heights[-1] > heights[0]).all()
    assert steps[-1].observation.conditions.in_p
