"""A recording returns the written data, as far as the file goes."""

import io
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from skyherd.analysis.history import make_history
from skyherd.analysis.summary import summarize
from skyherd.analysis.verdict import held_to_the_end, reached_s
from skyherd.datasets import load_mission
from skyherd.errors import InputError
from skyherd.loop import run_steps
from skyherd.recording.mcap_log import McapLog
from skyherd.recording.reader import read_messages, read_recording, read_steps
from skyherd.recording.writer import McapRecorder


@pytest.fixture(scope="module")
def mission():
    return load_mission("star", ["duration_s=1.0", "network.frame_loss=0.1", "network.message_loss=0.1"])


@pytest.fixture(scope="module")
def steps(mission):
    return list(run_steps(mission))


@pytest.fixture(scope="module")
def steps_again(mission):
    """Return the steps of the same mission, run a second time."""
    return list(run_steps(mission))


def record(path, mission, steps, *, images=False, wall_s=1.5):
    with McapRecorder(path, mission, images=images) as recorder:
        for step in steps:
            recorder.write(step)
        recorder.finish(steps[-1].time_s, wall_s)
    return path


@pytest.mark.smoke
def test_recording_gives_same_history(tmp_path, mission, steps):
    recording = read_recording(record(tmp_path / "run.mcap", mission, steps))
    live, read = make_history(mission, steps), make_history(recording.mission, recording.steps)
    for name in (
        "positions_m",
        "omega_radps",
        "V",
        "V_units",
        "scales",
        "controlled",
        "conditions",
        "heights_m",
    ):
        np.testing.assert_array_equal(getattr(live, name), getattr(read, name), err_msg=name)
    for mine, theirs in zip(live.traces, read.traces, strict=True):
        np.testing.assert_array_equal(mine.points_px, theirs.points_px)
    assert summarize(live, 1.5) == summarize(read, recording.wall_s)


def test_goals_and_detections_are_bit_exact(tmp_path, mission, steps):
    recording = read_recording(record(tmp_path / "run.mcap", mission, steps))
    for live, read in zip(steps, recording.steps, strict=True):
        for unit, frame in live.frames.items():
            theirs = read.frames[unit]
            np.testing.assert_array_equal(
                frame.sight.detections.corners_px, theirs.sight.detections.corners_px
            )
            np.testing.assert_array_equal(frame.decision.goals.rho_px, theirs.decision.goals.rho_px)


def test_turns_that_units_ask_for_are_read_back(tmp_path, mission, steps):
    seen = [step for step in steps if 0 in step.frames][:2]
    frame = seen[0].frames[0]
    turns = replace(frame.decision.goals, bearings_rad=np.full(len(frame.decision.goals.ids), np.pi / 2))
    asked = replace(frame, decision=replace(frame.decision, turns=turns))
    first = replace(seen[0], frames=seen[0].frames | {0: asked})
    recording = read_recording(record(tmp_path / "run.mcap", mission, [first, seen[1]]))
    read, after = (step.frames[0].decision for step in recording.steps)
    np.testing.assert_array_equal(read.turns.bearings_rad, turns.bearings_rad)
    np.testing.assert_array_equal(read.goals.bearings_rad, frame.decision.goals.bearings_rad)
    assert after.turns is None


def test_images_are_read_back_as_jpeg(tmp_path, mission, steps):
    path = record(tmp_path / "run.mcap", mission, steps[:2], images=True)
    assert read_recording(path).has_images
    unit = next(iter(steps[0].frames))
    live, read = steps[0].frames[unit].sight.image, next(iter(read_steps(path))).frames[unit].sight.image
    # JPEG at quality 90 quantises the finest DCT terms to about 20 levels; noise of 2 grey levels passes.
    assert np.abs(live.astype(int) - read.astype(int)).mean() < 2.5


@pytest.mark.parametrize("fraction", [0.35, 0.6, 0.95])
def test_truncated_file_reads_to_last_whole_chunk(tmp_path, mission, steps, fraction):
    path = record(tmp_path / "run.mcap", mission, steps)
    with path.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    end_of_chunks = max(chunk.chunk_start_offset + chunk.chunk_length for chunk in chunks)
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(path.read_bytes()[: int(end_of_chunks * fraction)])
    recording = read_recording(torn)
    assert recording.wall_s is None
    assert 0 < len(recording.steps) < len(steps)
    np.testing.assert_array_equal(
        recording.steps[-1].positions_m, steps[len(recording.steps) - 1].positions_m
    )
    # No more than one chunk is lost, which holds half a second.
    assert len(recording.steps) >= int(len(steps) * fraction) - 5


def test_run_of_one_step_is_whole(tmp_path, mission, steps):
    path = record(tmp_path / "run.mcap", mission, steps[:1])
    recording = read_recording(path)
    assert (len(recording.steps), recording.wall_s) == (1, 1.5)


def test_indexed_reader_accepts_whole_file(tmp_path, mission, steps):
    with record(tmp_path / "run.mcap", mission, steps).open("rb") as stream:
        summary = make_reader(stream).get_summary()
    topics = {channel.topic for channel in summary.channels.values()}
    assert {"/mission", "/unit/0/detections", "/unit/2/goals", "/robots/command", "/world", "/end"} <= topics
    assert summary.statistics.message_count == len(list(read_messages(tmp_path / "run.mcap")))


def test_non_recording_is_rejected(tmp_path):
    text = tmp_path / "run.mcap"
    text.write_text("not a recording")
    with pytest.raises(InputError, match="not a recording"):
        read_recording(text)
    with pytest.raises(InputError, match="no such file"):
        read_recording(tmp_path / "absent.mcap")


def older_scenario(topic, record):
    """Return a scenario of a version before steering had a name."""
    if topic == "/mission":
        record["scenario"]["avoidance"]["detour"] = True


def older_step(topic, record):
    """Return a world of a version without unit heights."""
    if topic == "/world":
        del record["fleet"]


@pytest.mark.parametrize(("change", "at"), [(older_scenario, "detour"), (older_step, "fleet")])
def test_recording_of_other_version_is_rejected(tmp_path, mission, steps, monkeypatch, change, at):
    put = McapLog.put

    def put_changed(self, topic, time_s, record, *schema):
        change(topic, record)
        put(self, topic, time_s, record, *schema)

    monkeypatch.setattr(McapLog, "put", put_changed)
    path = record(tmp_path / "run.mcap", mission, steps[:3])
    with pytest.raises(InputError, match=f"another version of skyherd .*{at}") as refusal:
        read_recording(path)
    assert "\n" not in str(refusal.value)


def messages_of(path):
    records = StreamReader(io.BytesIO(path.read_bytes())).records
    return [(r.channel_id, r.log_time, r.data) for r in records if isinstance(r, Message)]


@pytest.mark.smoke
def test_same_seed_gives_same_messages(tmp_path, mission, steps, steps_again):
    first = messages_of(record(tmp_path / "first.mcap", mission, steps))
    again = messages_of(record(tmp_path / "again.mcap", mission, steps_again, wall_s=2.5))
    other_mission = load_mission("star", ["duration_s=0.4"], seed=2)
    other = messages_of(record(tmp_path / "other.mcap", other_mission, list(run_steps(other_mission))))
    assert len(first) > 10 * 10
    assert first == again
    assert first[2 : len(other) - 1] != other[2:-1], "all but the mission itself and the end"


def test_same_run_and_wall_time_gives_same_file(tmp_path, mission, steps, steps_again):
    """Only the wall time may differ."""
    first = record(tmp_path / "first.mcap", mission, steps).read_bytes()
    assert record(tmp_path / "again.mcap", mission, steps_again).read_bytes() == first


@pytest.mark.parametrize(
    ("errors", "reached"),
    [
        ([9, 2, 0.5, 0.5], 2.0),
        ([0.5, 2, 0.5, 2], None),
        ([0.5, 0.5, 0.5, 0.5], 0.0),
        ([0.5, 2, np.nan, 0.5], 3.0),
    ],
)
def test_goal_is_reached_once_error_stays_below(errors, reached):
    """Four images per second with goal errors; an unknown error is not below."""
    second = ["duration_s=3.0", "step_s=1.0", "units.0.frame_rate_hz=1.0"]
    mission = load_mission("triangle", ["perception=ideal", *second])
    history = make_history(mission, run_steps(mission))
    goal = mission.scenario.goal.shape_error
    assert reached_s(replace(history, shape_error=goal * np.array(errors))) == reached


def test_converged_requires_hold_to_end(ideal_triangle):
    """Duration and hold time do not change the robots' behaviour until then."""

    def held(duration_s, hold_s):
        settings = [f"duration_s={duration_s}", f"goal.hold_s={hold_s}"]
        mission = load_mission("triangle", ["perception=ideal", *settings])
        return held_to_the_end(
            make_history(mission, [step for step in ideal_triangle if step.time_s <= duration_s])
        )

    assert held(80.0, 5)
    assert not held(20.0, 5)
    # Reached the threshold, but only just now: not held.
    assert not held(80.0, 60)
