"""The scene in a recording: valid messages, and poses and lines of the true world."""

import json

import numpy as np
import pytest
from mcap.reader import make_reader
from plain_messages import assert_valid

from skyherd.control import fit_similarity
from skyherd.datasets import load_mission
from skyherd.geometry import to_complex
from skyherd.loop import run_steps
from skyherd.recording.scene import SCENE_TOPICS
from skyherd.recording.writer import McapRecorder, recorded_topics


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return mission, steps, and messages by topic of one second of obstacles, recorded with images."""
    mission = load_mission("obstacles", ["duration_s=4"])
    steps, path = [], tmp_path_factory.mktemp("scene") / "run.mcap"
    with McapRecorder(path, mission, images=True) as recorder:
        for step in run_steps(mission):
            recorder.write(step)
            steps.append(step)
        recorder.finish(steps[-1].time_s, 1.0)
    messages: dict[str, list[dict]] = {}
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            messages.setdefault(channel.topic, []).append(json.loads(message.data))
    return mission, steps, messages


def test_messages_of_scene_follow_their_schemas(recorded) -> None:
    mission, steps, messages = recorded
    schemas = recorded_topics(len(mission.scenario.units))
    counts = {topic: len(messages[topic]) for topic in SCENE_TOPICS}
    assert counts == {"/scene/bodies": 1, "/scene/poses": len(steps), "/scene/shape": len(steps)}
    assert len(messages["/unit/0/overlay"]) == len(messages["/unit/0/image"]) > 0
    for topic in (*SCENE_TOPICS, "/unit/0/overlay"):
        for message in messages[topic]:
            assert_valid(message, schemas[topic][1])


def test_each_body_has_its_frame_at_its_true_pose(recorded) -> None:
    mission, steps, messages = recorded
    frames = {entity["frame_id"] for entity in messages["/scene/bodies"][0]["entities"]}
    assert frames >= {f"robot/{robot}" for robot in mission.ids.tolist()} | {"unit/0"}
    assert len(frames) == mission.ids.size + len(mission.scenario.units) + mission.obstacle_ids.size
    for step, message in zip(steps, messages["/scene/poses"], strict=True):
        poses = {pose["child_frame_id"]: pose for pose in message["transforms"]}
        assert poses.keys() == frames
        assert {pose["parent_frame_id"] for pose in poses.values()} == {"ground"}
        for robot, place_m, heading in zip(mission.ids, step.positions_m, step.headings_rad, strict=True):
            pose = poses[f"robot/{robot}"]
            assert [pose["translation"][axis] for axis in "xyz"] == pytest.approx([*place_m, 0.0])
            turn = complex(pose["rotation"]["w"], pose["rotation"]["z"]) ** 2
            assert turn == pytest.approx(np.exp(1j * heading), abs=1e-9)
        assert poses["unit/0"]["translation"]["z"] == pytest.approx(step.fleet.heights_m[0])


def test_lines_of_shape_are_those_of_best_fit(recorded) -> None:
    """The residual of the line's corners is that of the robots whose points they are."""
    mission, steps, messages = recorded
    step, (entity,) = steps[-1], messages["/scene/shape"][-1]["entities"]
    template = mission.shape_at(step.time_s, step.roles).points_of(mission.ids).conj()
    fit = fit_similarity(template, to_complex(step.positions_m))
    lines = mission.outline_at(step.time_s)
    assert len(entity["lines"]) == len(lines) > 0
    for drawn, line in zip(entity["lines"], lines, strict=True):
        points = np.array([point["x"] + 1j * point["y"] for point in drawn["points"]])
        np.testing.assert_allclose(points, fit(line.conj()), atol=1e-9)


def test_overlay_shows_each_marker_in_colour_of_controlling_unit(recorded) -> None:
    _, steps, messages = recorded
    frame = next(step.frames[0] for step in reversed(steps) if 0 in step.frames)
    overlay, seen = messages["/unit/0/overlay"][-1], frame.sight.detections
    assert [text["text"] for text in overlay["texts"]] == [str(robot) for robot in seen.ids.tolist()]
    outlines = [drawn for drawn in overlay["points"] if len(drawn["points"]) == 4]
    corners = np.array([[[point["x"], point["y"]] for point in drawn["points"]] for drawn in outlines])
    np.testing.assert_allclose(corners - 0.5, seen.corners_px, atol=1e-9)
    own = set(frame.decision.report.controlled_ids.tolist())
    colors = {
        robot in own: tuple(drawn["outline_color"].values())
        for robot, drawn in zip(seen.ids.tolist(), outlines, strict=True)
    }
    assert len(set(colors.values())) == len(colors) and True in colors
