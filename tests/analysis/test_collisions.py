"""Collisions, gaps and paths in a run's summary."""

from dataclasses import replace

import numpy as np
import pytest

from skyherd.analysis.history import History, make_history
from skyherd.analysis.summary import summarize
from skyherd.datasets import load_mission, make_mission
from skyherd.loop import run_steps

SIDE_M = 0.5


@pytest.fixture(scope="module")
def history(scenario_tree) -> History:
    """Return one second of the triangle of six with bodies 0.5 m across and an obstacle at the origin."""
    tree = scenario_tree("triangle") | {"perception": "ideal", "duration_s": 1.0}
    tree["marker"]["side_m"] = SIDE_M
    tree["robots"]["body_radius_sides"] = 0.5
    tree["obstacles"] = [{"id": 40, "position_m": [50.0, 0.0], "radius_sides": 2.0}]
    mission = make_mission(tree)
    return make_history(mission, run_steps(mission))


def moved(history: History, *changes: tuple[int, int, tuple[float, float]]) -> History:
    """Return robots on a static wide grid, except for those displaced at a step."""
    steps = len(history.times_s)
    grid = np.column_stack([3.0 * np.arange(6), np.full(6, 10.0)])
    positions = np.repeat(grid[None], steps, axis=0)
    for step, robot, place in changes:
        positions[step, robot] = place
    return replace(history, positions_m=positions)


def test_separate_robots_have_no_collision(history) -> None:
    """Robots 3 m apart with bodies of 0.25 m."""
    told = summarize(moved(history), 1.0)
    assert told["collisions"] == 0
    assert told["min_gap_m"] == pytest.approx(2.5)
    assert told["path_length_m"] == 0


def test_overlap_of_each_pair_is_counted_once(history) -> None:
    """Overlaps last two steps, recur, coincide, and involve an obstacle; one body only comes near."""
    beside = (0.4, 10.0)
    assert summarize(moved(history, (2, 1, beside), (3, 1, beside)), 1.0)["collisions"] == 1
    assert summarize(moved(history, (2, 1, beside), (4, 1, beside)), 1.0)["collisions"] == 2
    both = moved(history, (5, 1, beside), (5, 2, (0.2, 10.3)))
    assert summarize(both, 1.0)["collisions"] == 3, "all three pairs of three robots"
    obstacle = summarize(moved(history, (0, 3, (50.0, 1.2))), 1.0)
    assert obstacle["collisions"] == 1
    assert obstacle["min_gap_m"] == pytest.approx(1.2 - 1.0 - 0.25)
    near = summarize(moved(history, (5, 1, (0.51, 10.0))), 1.0)
    assert near["collisions"] == 0
    assert near["min_gap_m"] == pytest.approx(0.01)


def test_point_robots_have_no_collision(scenario_tree) -> None:
    mission = make_mission(scenario_tree("triangle") | {"perception": "ideal", "duration_s": 1.0})
    told = summarize(make_history(mission, run_steps(mission)), 1.0)
    assert told["collisions"] == 0
    assert told["min_gap_m"] == pytest.approx(told["min_separation_m"], rel=1e-12)


def test_run_path_is_not_below_shortest_path(ideal_triangle) -> None:
    """Up to the final shape error: `Σ d <= sqrt(N Σ d²)`, N times shape error times RMS radius."""
    mission = load_mission("triangle", ["perception=ideal", "duration_s=80"])
    history = make_history(mission, ideal_triangle)
    told, end = summarize(history, 1.0), history.positions_m[-1]
    lacking_m = len(end) * told["shape_error"] * np.sqrt(((end - end.mean(axis=0)) ** 2).sum(axis=1).mean())
    assert told["converged"]
    assert 0.1 * told["path_length_m"] < told["shortest_path_m"] <= told["path_length_m"] + lacking_m


def test_exchanges_count_instants_and_first_choice(history) -> None:
    steps = len(history.times_s)
    roles = np.repeat(np.arange(6)[None], steps, axis=0)
    assert summarize(replace(history, roles=roles), 1.0)["role_exchanges"] == 0
    first = roles.copy()
    first[:, [0, 1]] = first[:, [1, 0]]
    assert summarize(replace(history, roles=first), 1.0)["role_exchanges"] == 1
    again = first.copy()
    again[5:, [2, 3, 4]] = again[5:, [3, 4, 2]]
    assert summarize(replace(history, roles=again), 1.0)["role_exchanges"] == 2, "a cycle of three is one"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scramble", "obstacles"])
def test_crowd_converges_without_collision(name: str) -> None:
    """Without a detour: at most 1.5 times the shortest straight paths."""
    mission = load_mission(name, ["perception=noisy"])
    told = summarize(make_history(mission, run_steps(mission)), 1.0)
    assert told["converged"]
    assert told["collisions"] == 0
    assert told["min_gap_m"] > 0
    assert told["path_length_m"] < 1.5 * told["shortest_path_m"]
