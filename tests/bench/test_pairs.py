"""Benchmark of pair rules: times follow the law, and rules match their names."""

import numpy as np
import pytest

from skyherd.control.topology.convergence_rate import laplacian, slowest_rate
from skyherd.datasets import make_mission
from skyherd.datasets.generated.random_missions import star_mission
from skyherd.geometry import to_complex
from skyherd.sim.truth_metrics import fit_shape

SEED = 3


@pytest.fixture(scope="module")
def start():
    mission = make_mission(star_mission(SEED))
    return mission, mission.template.points_of(mission.ids).conj(), to_complex(mission.positions_m)


@pytest.mark.parametrize("step_s", [0.02, pytest.param(0.01, marks=pytest.mark.slow)])
def test_time_matches_small_steps_of_law(load_benchmark, start, step_s) -> None:
    """Euler's steps are off by `k λ dt / 2` of the time, and by the last step.

    With k = 0.5 and λ = 1 at most, `dt / 4`: 0.5 % at 0.02 s, half of that at 0.01 s; 0.3 dt is allowed.
    """
    _, points, positions = start
    pairs = load_benchmark("pairs")
    owners = np.argmin(np.abs(positions[:, None] - np.array([-5.0, 0.0, 5.0])), axis=1)
    sets = pairs.control_sets(owners, [(0, 1), (2, 3)])
    step = np.eye(positions.size) - pairs.GAIN * step_s * laplacian(points, sets)
    steps, moved = 0, positions
    while fit_shape(points, moved).error > pairs.GOAL:
        steps, moved = steps + 1, step @ moved
    assert pairs.time_to_goal_s(points, positions, sets) == pytest.approx(
        steps * step_s, rel=0.3 * step_s, abs=step_s
    )


def test_path_neighbours_share_only_their_pair(load_benchmark) -> None:
    owners = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2])
    sets = load_benchmark("pairs").control_sets(owners, [(2, 3), (5, 6)])
    assert [members.tolist() for members in sets] == [[0, 1, 2, 3], [2, 3, 4, 5, 6], [5, 6, 7, 8]]


def test_leverage_is_fastest_choice(load_benchmark, start) -> None:
    pairs = load_benchmark("pairs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pairs, "time_to_goal_s", lambda points, positions, sets: slowest_rate(points, sets))
        rates = pairs.choose(start[0])
    assert rates["leverage"] >= max(rates["widest"], rates["nearest"]) > 0
