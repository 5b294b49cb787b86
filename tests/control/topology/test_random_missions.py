"""Random missions keep what they promise, and a few of them keep TC1-TC5 and reach their shape."""

import argparse

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from skyherd.control import fit_similarity
from skyherd.datasets import make_mission
from skyherd.datasets.generated.random_missions import (
    IN_COMMON,
    LEGIBLE_PX,
    SIDE_M,
    legible,
    random_mission,
    star_mission,
)
from skyherd.geometry import to_complex, to_points
from skyherd.loop import run_steps
from skyherd.render import project
from skyherd.sim.physics import make_world


def options(**changed) -> argparse.Namespace:
    usual = {
        "start": "random",
        "share": "leverage",
        "perception": "noisy",
        "network": "perfect",
        "kill": False,
        "rival": None,
    }
    return argparse.Namespace(**(usual | changed))


@pytest.mark.parametrize("seed", range(6))
def test_a_random_mission_keeps_its_promises(seed) -> None:
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
    assert not left, "neighbours that see enough in common connect all units"


def test_a_legible_mission_is_the_same_with_finer_images() -> None:
    """Every ground point lies a whole number of times as far along each axis of the image, edge to edge."""
    tree = random_mission(1)
    coarse, fine = (make_mission(either) for either in (tree, legible(tree)))
    ground = np.array([[0.3, -1.2], [2.0, 0.4]])
    for unit in range(len(tree["units"])):
        pose = make_world(coarse).fleet.pose(unit)
        cameras = [make_world(mission).cameras[unit] for mission in (coarse, fine)]
        finer = cameras[1].size_px[0] // cameras[0].size_px[0]
        points = [project(camera, pose, ground) + 0.5 for camera in cameras]
        np.testing.assert_allclose(points[1], finer * points[0], rtol=1e-12)
        side_px = cameras[1].focal_px * SIDE_M / pose.height_m
        assert LEGIBLE_PX <= side_px < LEGIBLE_PX * finer / max(finer - 1, 0.5)


def test_no_marker_of_a_legible_mission_covers_another() -> None:
    """Bodies hold a card of a side and a sixth all around, whichever way it is turned, and stay apart."""
    scenario = make_mission(legible(random_mission(1))).scenario
    card = 1 + 2 / 6
    assert scenario.avoidance.on
    assert scenario.robots.body_radius_sides >= card / np.sqrt(2)


def test_the_same_seed_is_the_same_mission() -> None:
    assert random_mission(4) == random_mission(4) != random_mission(5)
    assert star_mission(4) == star_mission(4) != star_mission(5)


@pytest.mark.parametrize(
    ("seed", "network"),
    [(0, "perfect"), (38, "lossy"), pytest.param(9, "lossy", marks=pytest.mark.slow)],
)
def test_a_few_missions_stay_inside_p_and_reach_their_shape(load_benchmark, seed, network) -> None:
    """Two, three and five units; what `benchmarks/topology.py` does a thousand times."""
    row = load_benchmark("topology").run_mission(seed, options(network=network))
    assert row["converged"] and row["p_violation_s"] == 0.0
    assert row["time_to_1pct_s"] < 1.5 * row["predicted_s"]


@pytest.mark.parametrize("seed", [14, pytest.param(2, marks=pytest.mark.slow)])
def test_a_unit_that_dies_is_succeeded(load_benchmark, seed) -> None:
    """One of four units with 16 robots, and one of six with 48."""
    row = load_benchmark("topology").run_mission(seed, options(kill=True))
    assert row["converged"]
    assert 0 < row["tc12_back_s"] < 30 and row["covered_s"] < 30


def test_the_benchmark_notices_a_topology_that_leaves_p(load_benchmark) -> None:
    """Negative control: free overlaps are outside P from the first instant that counts."""
    module = load_benchmark("topology")
    made = module.mission_tree
    module.mission_tree = lambda seed, chosen: made(seed, chosen) | {"selection": {"kind": "radius"}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module.Watch, "see", _count_from_the_start(module.Watch.see))
        patch.setattr(module.Watch, "done", lambda watch, step: watch.violated_s["p"] > 1.0)
        row = module.run_mission(0, options())
    assert row["p_violation_s"] > 1.0


def test_a_mission_is_given_up_when_it_takes_many_times_as_long_as_its_rival(
    load_benchmark, tmp_path
) -> None:
    """And is then counted at the time it had, which is a lower bound."""
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
