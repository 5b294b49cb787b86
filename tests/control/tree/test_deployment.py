"""Before the tree is complete: units search, hold their position while it grows, search if it stalls."""

from itertools import combinations
from typing import Any

import numpy as np
import pytest

from skyherd.control.topology.convergence_rate import slowest_rate
from skyherd.control.tree.node_state import TreeSettings
from skyherd.datasets import make_mission
from skyherd.datasets.generated.random_missions import Crowd, random_mission
from skyherd.loop import Step, run_steps
from skyherd.messages import NO_ID


def is_ready(step: Step) -> bool:
    return any(frame.decision.report.tree.ready for frame in step.frames.values())


def until_ready(tree: dict[str, Any], limit_s: float) -> list[Step]:
    steps = []
    for step in run_steps(make_mission(tree | {"perception": "ideal"})):
        steps.append(step)
        if is_ready(step) or step.time_s > limit_s:
            break
    return steps


def founders(step: Step) -> list[int]:
    return [unit for unit, frame in step.frames.items() if frame.decision.report.tree.tree_id != NO_ID]


@pytest.mark.parametrize("seed", [0, 3])
def test_units_search_before_tree_and_hold_while_it_grows(seed) -> None:
    """The tree grows in every slot of these two missions; then units move to their sets.

    Others receive the founder's report with their next image, and cameras move a step after a command.
    """
    *before, at_once = until_ready(random_mission(seed), 20.0)
    assert is_ready(at_once)
    begun = next(row for row, step in enumerate(before) if founders(step))
    heights_m = np.array([step.fleet.heights_m for step in before])
    positions_m = np.array([step.fleet.positions_m for step in before])
    assert (np.diff(heights_m[: begun + 1], axis=0) > 0).all()
    assert (heights_m[begun + 2 :] == heights_m[begun + 2]).all()
    assert (positions_m[begun + 2 :] == positions_m[begun + 2]).all()
    assert len(before) > begun + 5
    commands = [frame.decision.flight for frame in at_once.frames.values()]
    assert any(command.climb_mps or command.lateral_mps.any() for command in commands)


def counts_inside(step: Step, radius: float) -> dict[int, int]:
    reports = {unit: frame.decision.report for unit, frame in step.frames.items()}
    return {unit: int((report.centre_distances < radius).sum()) for unit, report in reports.items()}


@pytest.mark.parametrize("seed", range(6))
def test_founder_sees_and_controls_most_robots(seed) -> None:
    """At least as many as any other unit reported of its image before."""
    mission = make_mission(random_mission(seed) | {"perception": "ideal"})
    radius, before = mission.scenario.selection.radius, {}
    for step in run_steps(mission):
        if founders(step):
            break
        before = counts_inside(step, radius)
    (founder,) = founders(step)
    inside = counts_inside(step, radius)[founder]
    assert len(step.control_sets[founder]) == inside
    assert (inside, -founder) >= max((count, -unit) for unit, count in before.items() if unit != founder)


def edge_rate(points: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
    """Return the rate at which two units agree by themselves."""
    both = np.union1d(one, other)
    return slowest_rate(points[both], [np.searchsorted(both, rows) for rows in (one, other)])


@pytest.mark.parametrize("firm", [0.2, 0.0])
def test_units_with_weak_edges_fly_to_stronger_pairs(firm) -> None:
    """Every edge becomes strong, up to the gain that a change requires; not with firm = 0."""
    tree = random_mission(3, Crowd(3, 6)) | {"perception": "ideal"}
    tree["selection"]["firm"] = firm
    mission, ready_s = make_mission(tree), np.inf
    for step in run_steps(mission):
        ready_s = min(ready_s, step.time_s if is_ready(step) else np.inf)
        assert step.metrics.conditions.in_p or not is_ready(step)
        if step.time_s > ready_s + 30:
            break
    rows = [np.searchsorted(mission.ids, members) for members in step.control_sets.values()]
    edges = [pair for pair in combinations(rows, 2) if np.intersect1d(*pair).size == 2]
    rates = [edge_rate(mission.template.points_px, *edge) for edge in edges]
    assert len(edges) == 2
    assert (min(rates) >= 0.2 / TreeSettings().gain) == (firm > 0)


def test_units_without_common_robots_climb() -> None:
    """No unit can ask another one: the tree does not grow for a slot, and they search again."""
    tree = random_mission(0)
    for unit in tree["units"]:
        unit["height_m"] = 0.5 * unit["height_m"]
    steps = until_ready(tree, 40.0)
    seen = [set(frame.sight.detections.ids.tolist()) for frame in steps[0].frames.values()]
    assert len(set.intersection(*seen)) < 2
    heights = np.array([step.fleet.heights_m for step in steps])
    still = np.flatnonzero((np.diff(heights, axis=0) == 0).all(axis=1))
    begun = next(step.time_s for step in steps if founders(step))
    assert begun <= steps[still[0]].time_s and steps[still[-1]].time_s >= begun + TreeSettings().dwell_s
    assert is_ready(steps[-1]) and (heights[-1] > heights[0]).all()
    assert steps[-1].metrics.conditions.in_p
