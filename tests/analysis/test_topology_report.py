"""Topology report: breaches name units and robots, and rates agree with the control law."""

import numpy as np
import pytest
from scipy.linalg import expm

from skyherd.analysis.history import History, make_history
from skyherd.analysis.summary import summarize
from skyherd.analysis.summary_fields import GROUPS
from skyherd.analysis.topology_changes import find_topology_changes
from skyherd.analysis.topology_report import (
    judge_topology,
    last_stretch,
    measured_rate_ps,
    predicted_time_s,
    resting_error,
)
from skyherd.control import Template
from skyherd.control.topology.convergence_rate import laplacian
from skyherd.datasets import make_mission
from skyherd.datasets.generated.random_missions import Crowd, random_mission
from skyherd.geometry import to_complex
from skyherd.loop import run_steps
from skyherd.sim.truth_metrics import fit_shape

RNG = np.random.default_rng(7)
IDS = np.arange(10, 18)
TEMPLATE = Template.from_ground_points(IDS, RNG.uniform(-1, 1, (8, 2)))


def report_of(*sets: list[int]):
    return judge_topology({unit: np.array(ids, dtype=int) for unit, ids in enumerate(sets)}, TEMPLATE)


def breaches(*sets: list[int]) -> dict[int, list[str]]:
    found: dict[int, list[str]] = {}
    for breach in report_of(*sets).breaches:
        found.setdefault(breach.condition, []).append(breach.what)
    return found


PATH = ([10, 11, 12, 13], [12, 13, 14, 15], [14, 15, 16, 17])


@pytest.mark.smoke
def test_path_graph_has_no_breach() -> None:
    report = report_of(*PATH)
    assert report.breaches == []
    assert report.conditions.in_p
    assert report.shared == {(0, 1): [12, 13], (1, 2): [14, 15]}
    assert report.slowest > 0


@pytest.mark.parametrize(
    ("sets", "conditions", "said"),
    [
        pytest.param(
            ([10, 11, 12, 13], [14, 15, 16, 17]), [1, 5], {1: ["0 | 1"], 5: ["TC1"]}, id="two islands"
        ),
        pytest.param(
            ([10, 11, 12, 13], [12, 13, 14]), [2], {2: ["robots 15, 16, 17"]}, id="robots without unit"
        ),
        pytest.param(
            ([10, 11, 12, 13, 14], [12, 13, 14, 15, 16, 17]),
            [3],
            {3: ["units 0 and 1", "share 3", "robots 12, 13, 14"]},
            id="neighbours share three",
        ),
        pytest.param(
            ([10, 11, 12, 13], [12, 13, 14, 15], [14, 15, 16, 17, 10]),
            [3],
            {3: ["units 0 and 2", "share 1", "robot 10"]},
            id="others share one",
        ),
        pytest.param(
            ([10, 11, 12, 13], [12, 13, 14, 15], [12, 13, 16, 17]),
            [4, 5],
            {4: ["robot 12", "3 units: 0, 1, 2", "robot 13"], 5: ["cycle: 0, 1, 2"]},
            id="a pair of three units",
        ),
        pytest.param(
            ([10, 11, 12, 13], [12, 13, 14, 15], [14, 15, 10, 11], [16, 17, 12]),
            [1, 3, 4, 5],
            {1: ["0, 1, 2 | 3"], 5: ["cycle: 0, 1, 2"]},
            id="a cycle, and a unit off it",
        ),
    ],
)
def test_breaches_name_units_and_robots(sets, conditions, said) -> None:
    """Exactly the violated conditions have breaches, and each names its cause."""
    found = breaches(*sets)
    assert sorted(found) == conditions
    for condition, words in said.items():
        for word in words:
            assert word in " ".join(found[condition])


@pytest.mark.parametrize("tried", [200, pytest.param(500, marks=pytest.mark.slow)])
def test_breaches_agree_with_check_conditions(tried: int) -> None:
    """On random topologies, report and the independent `check_conditions` agree."""
    rng = np.random.default_rng(3)
    for _ in range(tried):
        sets = [IDS[rng.random(8) < rng.uniform(0.1, 0.9)].tolist() for _ in range(int(rng.integers(1, 6)))]
        report, c = report_of(*sets), report_of(*sets).conditions
        holds = (c.tc1, c.tc2, c.tc3, c.tc4, c.tc5)
        assert {b.condition for b in report.breaches} == {k for k, good in enumerate(holds, 1) if not good}


def test_predicted_time_matches_linear_flow() -> None:
    """Against the matrix exponential: the shape error is 1 % then, to the root's tolerance."""
    rng = np.random.default_rng(4)
    report, gain = report_of(*PATH), 0.4
    positions = to_complex(rng.uniform(-5, 5, (8, 2)))
    time_s = predicted_time_s(report.sets, TEMPLATE, positions, gain, 0.01)
    assert time_s is not None and time_s > 0
    rows = [np.searchsorted(IDS, ids) for ids in report.sets.values()]
    flow = expm(-gain * time_s * laplacian(TEMPLATE.points_px, rows))
    moved = (flow @ positions.conj()).conj()
    assert fit_shape(TEMPLATE.points_px.conj(), moved).error == pytest.approx(0.01, rel=1e-6)


def test_predicted_time_is_none_for_free_shape() -> None:
    report = report_of([10, 11, 12, 13], [14, 15, 16, 17])
    assert predicted_time_s(report.sets, TEMPLATE, to_complex(RNG.uniform(-5, 5, (8, 2))), 0.4, 0.01) is None


@pytest.mark.parametrize("floor", [0.0, 1e-3])
def test_measured_rate_matches_exponential(floor) -> None:
    """Two modes, one fast; with a floor, the fit stays above three times the floor.

    By the second half (t > 20 s) the fast mode is below e^-14 of the slow one. A floor f is at most a third
    of the error, which takes that share off the slope at the end, and far less at the beginning.
    """
    times = np.arange(0, 120, 0.2)
    errors = 0.3 * np.exp(-0.08 * times) + 0.5 * np.exp(-0.8 * times) + floor
    errors = errors if floor else errors[times < 60]
    rate = measured_rate_ps(times[: errors.size], errors)
    assert rate == pytest.approx(0.08, rel=0.2 if floor else 1e-3)


def test_measured_rate_is_none_for_short_stretch() -> None:
    assert measured_rate_ps(np.arange(10.0), np.exp(-np.arange(10.0))) is None


@pytest.fixture(scope="module")
def small() -> History:
    """Return a history of 3 units and 12 robots for 30 s after the last switch, without speed limit."""
    tree = random_mission(3, Crowd(3, 4)) | {"perception": "ideal", "duration_s": 90.0}
    tree["robots"] |= {"max_speed_mps": 5.0}
    tree.setdefault("control", {})["rectify"] = False
    mission = make_mission(tree)
    return make_history(mission, run_steps(mission))


def test_predicted_rate_matches_measured_in_small_mission(small: History) -> None:
    """The linear law ignores that robots must turn. The slowest mode dominates late, with steady driving, so
    that turning barely matters. A tenth is allowed for the faster modes.
    """
    stretch = last_stretch(small)
    sets = {unit: small.ids[mine] for unit, mine in enumerate(small.controlled[-1])}
    report = judge_topology(sets, small.mission.template)
    measured = measured_rate_ps(small.times_s[stretch], small.shape_error[stretch])
    assert measured == pytest.approx(small.mission.scenario.control.k * report.slowest, rel=0.1)


def test_violations_count_from_complete_tree(small: History) -> None:
    summary = summarize(small, 1.0)
    ready_s = summary["ready_s"]
    assert 0 < ready_s < 60
    assert summary["p_violation_s"] == 0
    assert all(summary[f"tc{number}_violation_s"] == 0 for number in range(1, 6))
    before = small.times_s < ready_s - 1e-9
    assert not small.conditions[before].all(axis=1).all(), "there was something not to count"
    assert np.ptp(small.positions_m[: before.sum()], axis=0).max() == 0, "and robots held still meanwhile"
    assert summary["missing_robots"] == summary["unjoined_units"] == []
    assert {field.key for group in GROUPS.values() for field in group} < set(summary)


def test_changes_replay_to_last_topology(small: History) -> None:
    """Replaying the sentences gives the final units of each robot."""
    owners = {int(robot): "no unit" for robot in small.ids}
    for switch in find_topology_changes(small):
        if not switch.what.startswith("robot"):
            continue
        names, change = switch.what.split(": ")
        old, new = change.split(" → ")
        for robot in names.removeprefix("robots ").removeprefix("robot ").split(", "):
            assert owners[int(robot)] == old
            owners[int(robot)] = new
    for column, robot in enumerate(small.ids.tolist()):
        units = np.flatnonzero(small.controlled[-1, :, column])
        assert owners[robot].removeprefix("units ").removeprefix("unit ") == " + ".join(map(str, units))


@pytest.mark.parametrize("seed", range(5))
def test_resting_error_bounds_all_rest_states(seed) -> None:
    """The law with a threshold runs until all robots rest: every rest state is inside the bound.

    The start is in the slowest mode, which rests farthest out. It rests at a tenth of the bound or more, so
    that the bound has the right magnitude. With N robots, b / λ is reached only if all are equally far off.
    """
    rng = np.random.default_rng(seed)
    points, threshold, step = rng.normal(size=12) + 1j * rng.normal(size=12), 0.01, 0.2
    sets = [np.arange(0, 5), np.arange(3, 9), np.arange(7, 12)]
    matrix = laplacian(points, sets)
    values, modes = np.linalg.eigh(matrix)
    p = points + 3 * modes[:, 2]
    while (np.abs(matrix @ p) >= threshold).any():
        wish = matrix @ p
        p = p - step * np.where(np.abs(wish) >= threshold, wish, 0)
    kept = modes[:, :2] @ (modes[:, :2].conj().T @ p)
    rest = float(np.sqrt(np.mean(np.abs(p - kept) ** 2)))
    bound = resting_error(float(values[2]), threshold)
    assert bound / 10 < rest <= bound
