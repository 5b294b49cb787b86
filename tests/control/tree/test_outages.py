"""Temporary failure of a unit in the whole loop, and a lens that its unit zooms itself."""

from typing import Any

import numpy as np
import pytest

from skyherd.datasets import load_mission, make_mission
from skyherd.loop import Step, run_steps
from skyherd.messages import FlightCommand, VelocityCommand
from skyherd.sim.physics import make_world
from skyherd.sim.world import World

DIES_S, RETURNS_S = 1.0, 2.0
TIMEOUT_S = 0.4


@pytest.fixture
def tree_of(scenario_tree) -> Any:
    """Return the triangle under two units at one position that see all robots, 10 images a second."""

    def make(*units: dict[str, Any]) -> dict[str, Any]:
        tree = scenario_tree("triangle") | {"perception": "ideal", "duration_s": 3.0, "step_s": 0.1}
        base = {**tree["units"][0], "height_m": 14.0, "frame_rate_hz": 10.0, "flight": {"kind": "hover"}}
        tree["units"] = [base | unit for unit in units]
        tree["robots"]["timeout_s"] = TIMEOUT_S
        tree["selection"] = {"radius": 1.5}
        return tree

    return make


def between(steps: list[Step], start_s: float, end_s: float) -> list[Step]:
    return [step for step in steps if start_s - 1e-9 <= step.time_s < end_s - 1e-9]


def test_dead_unit_has_no_image_no_set_and_no_motion(tree_of) -> None:
    """The unit drifts before and after, but not in between; the conditions are evaluated without it."""
    drifting = {"flight": {"kind": "perimeter", "speed_mps": 0.5}, "outages": [[DIES_S, RETURNS_S]]}
    mission = make_mission(tree_of({}, drifting))
    steps = list(run_steps(mission))
    assert [tick for tick, step in enumerate(steps) if 1 not in step.frames] == list(range(10, 20))
    assert all(0 in step.frames for step in steps)
    for step in between(steps, DIES_S, RETURNS_S):
        assert mission.scenario.dead_units(step.time_s) == [1]
        assert step.control_sets[1].size == 0 and step.control_sets[0].size == 6
        assert step.metrics.conditions.in_p, "one living unit with all robots"
    places = np.array([step.fleet.positions_m[1] for step in steps])
    moved = np.linalg.norm(np.diff(places, axis=0), axis=1) > 0
    assert moved[:10].all() and not moved[10:20].any() and moved[20:].all()


def test_watchdog_stops_robots_after_goal_timeout(tree_of) -> None:
    """The only unit fails: robots follow the goals of the image before last for the timeout, then stop."""
    mission = make_mission(tree_of({"outages": [[DIES_S, RETURNS_S]]}))
    steps = list(run_steps(mission))
    last_image_s = DIES_S - 0.1
    for step in steps:
        follows = step.time_s <= last_image_s + TIMEOUT_S + 1e-6 or step.time_s >= RETURNS_S - 1e-6
        assert (step.commanded_ids.size == 6) == follows
        assert (np.abs(step.command.v_mps).max() > 0) == follows


def test_restarted_unit_has_no_state(tree_of) -> None:
    """Its set starts from the robots inside its radius now; with its memory it would have kept others."""
    tree = tree_of({"outages": [[DIES_S, RETURNS_S]]})
    tree["selection"] = {"radius": 0.35}
    mission = make_mission(tree)
    steps = list(run_steps(mission))
    first = steps[20].frames[0].sight.detections
    near = np.linalg.norm((first.centers_px - (first.image_size_px - 1) / 2) / 400, axis=1) < 0.35
    assert steps[20].control_sets[0].tolist() == np.sort(first.ids[near]).tolist()


def test_outages_of_several_units_overlap(tree_of) -> None:
    scenario = make_mission(
        tree_of({"outages": [[0.0, 1.0], [2.0, 2.5]]}, {"outages": [[0.5, 2.2]]})
    ).scenario
    dead = {time_s: scenario.dead_units(time_s) for time_s in (0.0, 0.5, 0.99, 1.0, 2.0, 2.2, 2.5)}
    assert dead == {0.0: [0], 0.5: [0, 1], 0.99: [0, 1], 1.0: [1], 2.0: [0, 1], 2.2: [0], 2.5: []}


# --- a unit's own zoom ---


def zoom_for(world: World, rate_ps: float, seconds: float, start_s: float = 0.0) -> float:
    """Return the first unit's zoom after a commanded relative change for some time."""
    rest = VelocityCommand(world.ids, np.zeros(world.ids.size), np.zeros(world.ids.size))
    world.fly(FlightCommand(0, np.zeros(2), 0.0, 0.0, rate_ps))
    for tick in range(round(10 * seconds)):
        world.advance(rest, start_s + tick / 10, 0.1)
    return world.camera_pose(0).zoom


def test_zoom_is_exponential_within_lens_range(tree_of) -> None:
    """`zoom' = rate zoom`, so that `zoom(t) = exp(rate t)`, to rounding, until the range ends."""
    world = make_world(make_mission(tree_of({"zoom_range": [0.5, 2.0]})))
    assert zoom_for(world, 0.3, 2.0) == pytest.approx(np.exp(0.6), rel=1e-12)
    assert zoom_for(world, 0.3, 2.0) == 2.0
    assert zoom_for(world, -0.5, 1.0) == pytest.approx(2 * np.exp(-0.5), rel=1e-12), "no wind-up at the end"
    assert zoom_for(world, -0.5, 9.0) == 0.5
    fixed = make_world(make_mission(tree_of({})))
    assert zoom_for(fixed, 0.3, 2.0) == 1.0, "a lens without a range"


def test_scripted_zoom_multiplies_zoom_of_unit(tree_of) -> None:
    world = make_world(make_mission(tree_of({"zoom_range": [0.5, 4.0], "zoom": [[0.0, 1.0], [2.0, 1.5]]})))
    assert zoom_for(world, 0.2, 2.0) == pytest.approx(1.5 * np.exp(0.4), rel=1e-12)


def test_robots_out_of_view_are_taken_over() -> None:
    """Below a ceiling: the founder sees all of its robots only while they stand close together.

    Units learn the ceiling, and visit the robots that no image shows.
    """
    mission = load_mission("scramble", ["perception=ideal", "control.rectify=false"])
    covered, visited_s = [], np.full(mission.ids.size, -np.inf)
    for step in run_steps(mission):
        seen = [
            np.intersect1d(step.control_sets[unit], frame.sight.detections.ids)
            for unit, frame in step.frames.items()
        ]
        covered.append(np.unique(np.concatenate(seen)).size == mission.ids.size)
        visited_s[np.searchsorted(mission.ids, np.concatenate(seen))] = step.time_s
        if step.time_s >= 48.0:
            break
    heights_m, ceiling_m = step.fleet.heights_m, mission.scenario.autopilot.max_height_m
    assert heights_m.max() == ceiling_m
    ready = next(row for row, yes in enumerate(covered) if yes)
    assert not all(covered[ready:]), "it loses some during the run"
    assert visited_s.min() >= 48.0 - 20.0
    assert step.metrics.conditions.in_p
    assert step.metrics.shape.error < 0.01
