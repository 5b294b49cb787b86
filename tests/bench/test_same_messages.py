"""`benchmarks/same_messages.py`: equal recordings of one seed, and differences by topic."""

import pytest

from skyherd.datasets import load_mission
from skyherd.loop import run_steps
from skyherd.recording.writer import McapRecorder


@pytest.fixture(scope="module")
def same_messages(load_benchmark):
    return load_benchmark("same_messages")


@pytest.fixture(scope="module")
def topics_of(same_messages, tmp_path_factory):
    """Record `triangle` for half a second with projected markers, and return the topics of the file."""

    def record(seed, duration_s=0.5):
        path = tmp_path_factory.mktemp("run") / "run.mcap"
        mission = load_mission("triangle", [f"duration_s={duration_s}", "perception=noisy"], seed=seed)
        with McapRecorder(path, mission) as recorder:
            for step in run_steps(mission):
                recorder.write(step)
            recorder.finish(step.time_s, 0.0)
        return same_messages.read_topics(path)

    return record


@pytest.mark.smoke
def test_recordings_of_one_seed_are_equal(same_messages, topics_of):
    one = topics_of(3)
    assert {"/mission", "/world", "/unit/0/detections", "/end"} <= one.keys()
    assert same_messages.differences(one, topics_of(3)) == []


def test_recordings_of_two_seeds_differ_from_the_first_image(same_messages, topics_of):
    lines = same_messages.differences(topics_of(3), topics_of(4))
    assert any(line.startswith("/unit/0/detections: ") and line.endswith("is 0") for line in lines)
    assert not any(line.startswith("/end") for line in lines)


def test_missing_topic_and_message_are_reported(same_messages):
    whole = {"/a": same_messages.Topic(2, ("x", "y")), "/b": same_messages.Topic(1, ("z",))}
    part = {"/a": same_messages.Topic(1, ("x",))}
    assert same_messages.differences(whole, part) == [
        "/a: 2 and 1 messages, the first that differs is 1",
        "/b: 1 and 0 messages, the first that differs is 0",
    ]
