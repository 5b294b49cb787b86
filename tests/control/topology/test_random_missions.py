"""Random missions satisfy their specification; some of them keep TC1-TC5 and reach their shape."""

import argparse

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from skyherd.control import TeamClock, fit_similarity
from skyherd.datasets import make_mission
from skyherd.datasets.generated.random_missions import (
    IN_COMMON,
    LEGIBLE_PX,
    SIDE_M,
    random_mission,
    star_mission,
)
from skyherd.geometry import to_complex, to_points
from skyherd.loop import run_steps
from skyherd.sim.physics import make_world


def options(**changed) -> argparse.Namespace:
    usual = {
        "start": "random",
        "share": "leverage",
        "perception": "noisy",
        "network": "perfect",
        "kill": False,
        "survivor": False,
        "radio": None,
        "form": "random",
        "units": None,
        "clocks": None,
        "rival": None,
    }
    return argparse.Namespace(**(usual | changed))


@pytest.mark.parametrize("seed", range(6))
def test_random_mission_satisfies_its_specification(seed) -> None:
    mission = make_mission(random_mission(seed) | {"perception": "ideal"})
    robots, template = to_complex(mission.positions_m), mission.template.points_px.conj()
    assert 4 * len(mission.scenario.units) <= mission.ids.size <= 64
    fitted = fit_similarity(template, robots)(template)
    assert pdist(to_points(fitted)).min() >= 2 * SIDE_M
    first = next(iter(run_steps(mission)))
    seen = [set(frame.sight.detections.ids.tolist()) for frame in first.frames.values()]
    assert set().union(*seen) == set(mission.ids.tolist())
    reached, left = {0}, set(range(1, len(seen)))
    while left and (more := {u for u in left if any(len(seen[u] & seen[k]) >= IN_COMMON for k in reached)}):
        reached, left = reached | more, left - more
    assert not left, "neighbours with enough common robots connect all units"


def test_random_mission_markers_are_legible_at_start() -> None:
    """Each is at least LEGIBLE_PX large, by the focal length and the height, and none twice as large."""
    world = make_world(make_mission(random_mission(1)))
    for unit, camera in enumerate(world.cameras):
        side_px = camera.focal_px * SIDE_M / world.fleet.pose(unit).height_m
        assert LEGIBLE_PX <= side_px < 2 * LEGIBLE_PX


def test_random_mission_rendered_equals_projected() -> None:
    """Only the perception differs: rendered images also show markers that the border cuts."""
    steps = [
        next(iter(run_steps(make_mission(random_mission(0) | {"perception": perception}))))
        for perception in ("noisy", "rendered")
    ]
    seen = [{u: frame.sight.detections for u, frame in step.frames.items()} for step in steps]
    for unit, projected in seen[0].items():
        drawn = seen[1][unit]
        both = drawn.select(projected.ids)
        assert len(both) == len(projected) >= 5
        order = np.argsort(both.ids), np.argsort(projected.ids)
        assert np.abs(both.centers_px[order[0]] - projected.centers_px[order[1]]).max() < 0.05


def test_random_mission_markers_do_not_overlap() -> None:
    """Bodies contain a card of a side plus a sixth on all sides in any rotation, and do not touch."""
    scenario = make_mission(random_mission(1)).scenario
    card = 1 + 2 / 6
    assert scenario.avoidance.on
    assert scenario.robots.body_radius_sides >= card / np.sqrt(2)


def test_random_mission_is_deterministic_in_seed() -> None:
    assert random_mission(4) == random_mission(4) != random_mission(5)
    assert star_mission(4) == star_mission(4) != star_mission(5)


@pytest.mark.parametrize(
    ("seed", "network"),
    [(0, "perfect"), (38, "lossy"), pytest.param(9, "lossy", marks=pytest.mark.slow)],
)
def test_random_missions_stay_in_p_and_converge(load_benchmark, seed, network) -> None:
    """Two, three and five units, as in a thousand runs of `benchmarks/topology.py`."""
    row = load_benchmark("topology").run_mission(seed, options(network=network))
    assert row["converged"] and row["p_violation_s"] == 0.0
    assert row["time_to_1pct_s"] < 1.5 * row["predicted_s"]


@pytest.mark.parametrize("seed", [14, pytest.param(2, marks=pytest.mark.slow)])
def test_failed_unit_is_succeeded(load_benchmark, seed) -> None:
    """One of four units with 16 robots, and one of six with 48."""
    row = load_benchmark("topology").run_mission(seed, options(kill=True))
    assert row["converged"]
    assert 0 < row["tc12_back_s"] < 30 and row["covered_s"] < 30


@pytest.mark.parametrize(
    ("seed", "form", "relay", "left"),
    [
        (3, "chain", True, False),
        (3, "chain", False, True),
        pytest.param(3, "chain", False, False, marks=pytest.mark.slow),
        pytest.param(0, "star", True, False, marks=pytest.mark.slow),
    ],
)
def test_relay_keeps_units_with_short_range_in_p(load_benchmark, seed, form, relay, left) -> None:
    """Five units with a radio range a tenth above the minimum; without relays they leave P.

    With `left` the mission ends at that time; without it the shape is reached nevertheless.
    """
    module = load_benchmark("topology")
    made = module.mission_tree

    def tree(number, chosen):
        changed = made(number, chosen)
        return changed | {"network": changed["network"] | {"relay": relay}}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "mission_tree", tree)
        if left:
            patch.setattr(module.Watch, "done", lambda watch, step: watch.violated_s["p"] > 0.0)
        row = module.run_mission(seed, options(radio=1.1, form=form, units=(5, 5)))
    assert row["cut_s"] == 0 and row["min_gap_m"] > 0 and (row["converged"] or left)
    assert (row["p_violation_s"] == 0) == relay


@pytest.mark.parametrize("learns", [True, False])
def test_team_time_keeps_units_with_different_clocks_in_p(load_benchmark, learns) -> None:
    """Three clocks that are 1.8 to 3.8 s slow, so that the mission starts at negative times, and drift.

    Negative control: units that use each other's stamps unchanged.
    """
    module = load_benchmark("topology")
    with pytest.MonkeyPatch.context() as patch:
        if not learns:
            patch.setattr(TeamClock, "hear", lambda *_: None)
            patch.setattr(module.Watch, "done", lambda watch, step: watch.violated_s["p"] > 1.0)
        row = module.run_mission(5020, options(clocks=5.0))
    assert row["min_gap_m"] > 0
    assert (row["p_violation_s"] == 0 and row["converged"]) == learns


@pytest.mark.parametrize("seed", [2, pytest.param(8, marks=pytest.mark.slow)])
def test_surviving_unit_brings_all_robots_into_shape(load_benchmark, seed) -> None:
    """All units except one fail, at one time or one after the other."""
    row = load_benchmark("topology").run_mission(seed, options(survivor=True))
    assert row["units"] >= 4 and row["converged"]


def test_benchmark_detects_topology_outside_p(load_benchmark) -> None:
    """Negative control: overlapping sets are outside P from the first evaluated instant."""
    module = load_benchmark("topology")
    made = module.mission_tree
    module.mission_tree = lambda seed, chosen: made(seed, chosen) | {"selection": {"kind": "radius"}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module.Watch, "see", _count_from_the_start(module.Watch.see))
        patch.setattr(module.Watch, "done", lambda watch, step: watch.violated_s["p"] > 1.0)
        row = module.run_mission(0, options())
    assert row["p_violation_s"] > 1.0


def test_slow_mission_is_stopped_and_counted_as_lower_bound(load_benchmark, tmp_path) -> None:
    """A mission that takes many times as long as its rival counts with its elapsed time, a lower bound."""
    rival = tmp_path / "rival.jsonl"
    rival.write_text('{"seed": 0, "time_to_1pct_s": 0.5, "ready_s": 4.0, "simulated_s": 9.0}\n')
    module = load_benchmark("topology")
    row = module.run_mission(0, options(rival=rival))
    assert row["time_to_1pct_s"] is None and not row["converged"]
    assert row["simulated_s"] - row["ready_s"] == pytest.approx(0.5 * module.GIVE_UP, abs=0.2 + 1e-9)
    compared = module.compare(module.read_rows(rival), [row])
    assert compared["ratio_quantiles_0_5_25_50_75_95_100"][0] == pytest.approx(module.GIVE_UP, abs=0.41)


def _count_from_the_start(see):
    def counted(watch, step) -> None:
        if watch.ready_s is None:
            watch.ready_s, watch.log_need = 0.0, float(np.log(step.metrics.shape.error / 0.01))
        see(watch, step)

    return counted
