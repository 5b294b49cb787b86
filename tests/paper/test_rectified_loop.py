"""Self-rectification in the loop: distorting cameras with and without it, recordings, images."""

import json
from functools import cache
from typing import Any

import numpy as np
import pytest
from seen_squares import random_view

from skyherd.analysis.goal_points import desired_points_px
from skyherd.control import AerialController, Hover, Rectifier, SafetyRadius
from skyherd.datasets import make_mission
from skyherd.loop import Step, run_steps
from skyherd.recording.reader import read_recording
from skyherd.recording.writer import McapRecorder
from skyherd.render import project
from skyherd.sim.truth_metrics import fit_shape


def bad_camera(seed: int) -> dict[str, Any]:
    """Return a camera with tilt, oblong pixels, skew and lens, as in `random_view`."""
    view = random_view(seed)
    return {
        "position_m": list(view.pose.position_m),
        "height_m": view.pose.height_m,
        "tilt_deg": list(view.tilt_deg),
        "yaw_deg": float(np.degrees(view.yaw_rad)),
        "camera": {
            "size_px": [800, 800],
            "focal_px": view.camera.focal_px,
            "aspect": view.camera.aspect,
            "skew": view.camera.skew,
            "distortion": {"k1": view.camera.distortion.k1},
        },
        "flight": {"kind": "hover"},
    }


def flight(
    scenario_tree: Any,
    unit: dict[str, Any],
    *,
    rectify: bool,
    perception: str = "ideal",
    duration_s: float = 20.0,
) -> list[Step]:
    """Return the triangle of six, smaller and faster; the robots never stop."""
    tree = scenario_tree("triangle") | {"duration_s": duration_s, "units": [unit], "perception": perception}
    tree["robots"] = {"scatter": {"scale_m": 1.7, "jitter_m": 0.3, "spacing_m": 0.8}}
    tree["selection"] = {"radius": 1.5}
    tree["control"] |= {"k": 0.6, "k_omega": 2.4, "b_th": 0.0, "rectify": rectify}
    return flown(json.dumps(tree))


@cache
def flown(tree: str) -> list[Step]:
    """Return all steps of a mission, given as JSON: several tests read the same flights."""
    return list(run_steps(make_mission(json.loads(tree))))


@pytest.mark.parametrize("seed", [5, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (3, 8))])
def test_rectification_forms_shape_with_distorting_camera(scenario_tree, seed):
    """Without rectification the robots form the template in the *image*, up to ten time constants.

    The error on the ground is then that of the template seen through the camera, from geometry. With
    rectification it is 1 % of that.
    """
    unit = bad_camera(seed)
    plain, ours = (flight(scenario_tree, unit, rectify=rectify)[-1] for rectify in (False, True))
    seen = plain.frames[0].sight.detections.centers_px @ np.array([1, 1j])
    mission = make_mission(scenario_tree("triangle"))
    template = mission.template.points_of(mission.ids)
    assert fit_shape(template, seen).error < 1e-3
    view = random_view(seed)
    from_image = view.ideal_px(plain.frames[0].sight.detections.centers_px)
    predicted = fit_shape(template, from_image @ np.array([1, 1j])).error
    assert plain.metrics.shape.error == pytest.approx(predicted, abs=1e-6)
    assert plain.metrics.shape.error > 0.02
    assert ours.metrics.shape.error < 1e-3
    assert ours.metrics.shape.error < plain.metrics.shape.error / 20


def test_rectified_ground_goals_are_invariant_to_camera(scenario_tree, reference_fit):
    """Property 1 for a camera that it excludes: positions of the desired points on the ground.

    From the first image alone they agree to 1e-3 of the formation's span. Without rectification the error is
    20 times as large.
    """
    unit = bad_camera(5)
    view = random_view(5)
    off = []
    for rectify in (False, True):
        step = flight(scenario_tree, unit, rectify=rectify, duration_s=0.1)[0]
        frame = step.frames[0]
        mission = make_mission(scenario_tree("triangle"))
        template = mission.template.points_of(mission.ids)
        positions = step.positions_m @ np.array([1, 1j])
        a, b = reference_fit(template.conj(), positions)
        wanted = a * template.conj() + b
        wanted_px = project(view.camera, view.pose, np.column_stack([wanted.real, wanted.imag]))
        # In the image of an ideal camera, where pixels are in proportion to metres.
        ideal = [view.ideal_px(points) for points in (desired_points_px(frame.decision), wanted_px)]
        span = np.ptp(ideal[1], axis=0).max()
        off.append(np.linalg.norm(ideal[0] - ideal[1], axis=1).max() / span)
    assert off[1] < 1e-3
    assert off[0] > 20 * off[1]


def test_rectified_speed_uses_local_scale(scenario_tree):
    """Under tilt each goal is in the robot's own marker sides.

    From the same start a tilted, distorting camera and an ideal one drive the robots along the same paths, to
    2 % of a marker's side.
    """
    unit = bad_camera(5)
    ideal = unit | {"tilt_deg": [0, 0], "position_m": [0, 0], "height_m": 14.0}
    ideal["camera"] = {"size_px": [800, 800], "focal_px": 800.0}
    paths = [
        np.array([step.positions_m for step in flight(scenario_tree, camera, rectify=True)])
        for camera in (unit, ideal)
    ]
    assert np.linalg.norm(paths[0][-1] - paths[0][0], axis=1).max() > 0.2
    assert np.abs(paths[0] - paths[1]).max() < 0.02 * 0.5


@pytest.mark.parametrize("duration_s", [5.0, pytest.param(8.0, marks=pytest.mark.slow)])
def test_ideal_camera_flight_is_unchanged_by_rectifier(scenario_tree, duration_s):
    """Measured noise, and three units that hand robots over: the rectifier finds no effect."""
    tree = scenario_tree("star") | {"duration_s": duration_s, "perception": "noisy"}
    runs = []
    for rectify in (False, True):
        tree["control"]["rectify"] = rectify
        runs.append(list(run_steps(make_mission(tree))))
    for one, other in zip(*runs, strict=True):
        np.testing.assert_array_equal(one.positions_m, other.positions_m)
        np.testing.assert_array_equal(one.command.v_mps, other.command.v_mps)


def test_controller_decides_on_rectified_detections(scenario_tree):
    """The loop's decision equals that of a controller without a rectifier."""
    mission_tree = scenario_tree("triangle")
    steps = flight(scenario_tree, bad_camera(3), rectify=True)[:5]
    rectifier, mission = Rectifier(), make_mission(mission_tree)
    agents = AerialController(mission.template, SafetyRadius(radius=1.5), Hover())
    for step in steps:
        goals = agents.step(rectifier.rectify(step.frames[0].sight.detections)).goals
        np.testing.assert_array_equal(goals.rho_px, step.frames[0].decision.goals.rho_px)


def test_ground_maps_are_recorded_and_read(scenario_tree, tmp_path):
    """The video drawn from the file shows the same goals; a camera without a map has no such topic."""
    tree = scenario_tree("triangle") | {"duration_s": 3.0, "perception": "ideal"}
    tree["units"] = [bad_camera(3)]
    tree["robots"] = {"scatter": {"scale_m": 1.7, "jitter_m": 0.3, "spacing_m": 0.8}}
    mission = make_mission(tree)
    steps = list(run_steps(mission))
    with McapRecorder(tmp_path / "run.mcap", mission) as recorder:
        for step in steps:
            recorder.write(step)
        recorder.finish(3.0, 1.0)
    for one, other in zip(steps, read_recording(tmp_path / "run.mcap").steps, strict=True):
        assert not one.frames[0].decision.ground_map.ideal
        np.testing.assert_array_equal(
            one.frames[0].decision.ground_map.unknowns, other.frames[0].decision.ground_map.unknowns
        )
        np.testing.assert_array_equal(
            desired_points_px(one.frames[0].decision), desired_points_px(other.frames[0].decision)
        )


def test_requested_points_are_drawn_at_camera_positions(scenario_tree):
    """Once the shape is formed they lie on the robots, in the raw image."""
    frame = flight(scenario_tree, bad_camera(5), rectify=True)[-1].frames[0]
    np.testing.assert_allclose(desired_points_px(frame.decision), frame.sight.detections.centers_px, atol=0.5)
