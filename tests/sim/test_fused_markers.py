"""Missions of robots with several markers each: hidden markers, and the truth of images."""

import numpy as np
import pytest
from five_markers import cubes, five_markers

from skyherd.datasets import make_mission
from skyherd.loop import run_steps
from skyherd.render import project

HIDDEN = 1 / 3
"""Share of the time in which each marker is hidden."""

PERIOD_S = 1.5
"""Time between two coverings of one marker. Chosen: hidden markers stay so for five images."""


def hiding(tree, seed: int):
    """Return a scenario in which each marker is covered for a third of each period, at a random time."""
    rng = np.random.default_rng(seed)
    markers = [
        robot + place.get("add_to_id", 0)
        for robot in range(len(tree["template"]["points"]))
        for place in tree["robots"]["markers"] or [{}]
    ]
    changes = []
    for marker in markers:
        start_s = -rng.uniform(0, PERIOD_S)
        while start_s < tree["duration_s"]:
            for at_s, covered in ((start_s, True), (start_s + HIDDEN * PERIOD_S, False)):
                changes.append(
                    {"kind": "cover", "marker": marker, "at_s": max(at_s, 0.0), "covered": covered}
                )
            start_s += PERIOD_S
    tree["interventions"] = sorted(changes, key=lambda change: change["at_s"])
    return tree


def share_seen(steps) -> float:
    """Return the share of robots and steps in which a unit detects the robot."""
    found = [{*(i for f in step.frames.values() for i in f.sight.detections.ids.tolist())} for step in steps]
    return float(np.mean([len(ids) / 6 for ids in found]))


def longest_gap_s(steps) -> float:
    """Return the longest time for which no unit detects a robot."""
    times_s = np.array([step.time_s for step in steps])
    longest = 0.0
    for robot in range(6):
        seen = [any(robot in frame.sight.detections.ids for frame in step.frames.values()) for step in steps]
        at_s = np.concatenate([[times_s[0]], times_s[seen], [times_s[-1]]])
        longest = max(longest, float(np.diff(at_s).max()))
    return longest


@pytest.mark.parametrize(
    "duration_s", [1.5, pytest.param(15.0, marks=pytest.mark.slow)], ids=lambda s: f"{s:g}s"
)
@pytest.mark.parametrize("scenario", [five_markers, cubes])
def test_no_robot_is_lost_while_markers_are_hidden(duration_s, scenario) -> None:
    """Tilted cameras, rendered images, and each marker hidden for a third of the time."""
    mission = make_mission(hiding(scenario() | {"duration_s": duration_s}, seed=2))
    steps = [step.without_images() for step in run_steps(mission)]
    assert longest_gap_s(steps) <= 2 * mission.scenario.step_s + 1e-9
    seen = [frame.sight for step in steps for frame in step.frames.values()]
    assert sum(sight.false_detections for sight in seen) == 0
    assert share_seen(steps) > 0.98
    if duration_s > 10:
        assert steps[-1].metrics.shape.error < 0.01
    assert steps[-1].metrics.shape.error < steps[0].metrics.shape.error


def test_robots_with_one_marker_are_lost_while_it_is_hidden() -> None:
    """Negative control: a third of the detections is missing."""
    tree = five_markers() | {"duration_s": 3.0, "perception": "ideal"}
    tree["robots"]["markers"] = []
    steps = list(run_steps(make_mission(hiding(tree, seed=2))))
    assert 0.6 < share_seen(steps) < 0.73
    assert longest_gap_s(steps) > 0.4


def test_one_visible_marker_makes_a_robot_whole_and_found() -> None:
    tree = five_markers() | {"duration_s": 0.0001, "perception": "ideal"}
    cover = [{"kind": "cover", "at_s": 0.0, "marker": 3 + add} for add in (0, 10, 30, 40)]
    sight = next(run_steps(make_mission(tree | {"interventions": cover}))).frames[0].sight
    assert sight.whole_ids.tolist() == sight.found_ids.tolist() == list(range(6))
    assert sorted(sight.detections.ids.tolist()) == list(range(6))
    all_five = [*cover, {"kind": "cover", "at_s": 0.0, "marker": 23}]
    sight = next(run_steps(make_mission(tree | {"interventions": all_five}))).frames[0].sight
    assert 3 not in sight.detections.ids


def test_controller_gets_robots_and_never_markers() -> None:
    tree = five_markers() | {"duration_s": 0.5, "perception": "ideal"}
    for step in run_steps(make_mission(tree)):
        for frame in step.frames.values():
            assert set(frame.sight.detections.ids.tolist()) <= set(range(6))
            assert set(frame.decision.report.ids.tolist()) <= set(range(6))


def test_cubes_with_tops_alone_are_lost_while_they_are_hidden() -> None:
    """Negative control: the faces on the sides keep the cubes in view."""
    tree = cubes() | {"duration_s": 3.0}
    tree["robots"]["markers"] = tree["robots"]["markers"][:1]
    steps = [step.without_images() for step in run_steps(make_mission(hiding(tree, seed=2)))]
    assert 0.6 < share_seen(steps) < 0.73
    assert longest_gap_s(steps) > 0.4


def test_robots_of_cubes_are_where_they_stand() -> None:
    """Errors of the reference points on the ground are within four standard deviations."""
    mission = make_mission(cubes() | {"duration_s": 0.3})
    for step in run_steps(mission):
        for unit, frame in step.frames.items():
            camera, pose = mission.scenario.units[unit].camera.make(), step.fleet.pose(unit)
            found = frame.sight.detections
            rows = np.searchsorted(mission.ids, found.ids)
            truth = project(camera, pose, step.positions_m[rows])
            stds = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2)[:, :2])
            assert (abs(found.centers_px - truth) < 4 * stds).all() and stds.max() < 0.2
