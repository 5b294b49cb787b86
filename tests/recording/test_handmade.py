"""Recordings with valid checksums and footer but altered content.

A value in a recording is replaced by an invalid one. Either the recording is rejected in one line, or all
readers of recordings can process it: nothing fails later.
"""

import json

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from skyherd.analysis.history import make_history
from skyherd.analysis.summary import summarize
from skyherd.analysis.topology_changes import find_topology_changes
from skyherd.analysis.topology_report import judge_topology, last_stretch, measured_rate_ps
from skyherd.datasets import load_mission
from skyherd.errors import InputError
from skyherd.loop import run_steps
from skyherd.recording.reader import read_messages, read_recording
from skyherd.recording.writer import McapRecorder, recorded_topics
from skyherd.runner import make_report

NASTY = (
    None, True, -1, 0, 1, 2**40, 2**64 - 1, 1e300, -1e300, 1e-320, 0.5, "", "nan", "x" * 3000, "\0",
    [], {}, [[]], [None], [1e300, 0], [[[1, 2]]], {"a": 1}, [0] * 500, {"scenario": 3},
)  # fmt: skip
"""Replacement values."""

SETTINGS = [
    "duration_s=0.2",
    "perception=ideal",
    "units.*.tilt_deg=[3, 4]",
    "roles.exchange=true",
    "avoidance.on=true",
    "robots.body_radius_sides=0.5",
]
"""Three steps of a tree of units with ground maps, roles and proximity."""


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    """Return the messages of a recording with a tree of units."""
    return recorded(load_mission("chain", SETTINGS), tmp_path_factory.mktemp("real") / "run.mcap")


def recorded(mission, path):
    """Return topic, time and content of a recording's messages, each content as JSON text."""
    with McapRecorder(path, mission) as recorder:
        for step in run_steps(mission):
            recorder.write(step)
        recorder.finish(step.time_s, 1.0)
    return [(topic, time_s, json.dumps(record)) for topic, time_s, record in read_messages(path)]


def write(path, messages, *, chunk_size=2**40, wall_s="1.0"):
    """Write messages as `McapRecorder` does, but with one mission, and all in one chunk."""
    topics = recorded_topics(8)
    with path.open("wb") as stream:
        writer = Writer(
            stream, chunk_size=chunk_size, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {topic: writer.register_channel(topic, "json", schema) for topic in topics}
        for number, (topic, time_s, text) in enumerate(messages):
            at = round(time_s * 1e9)
            writer.add_message(
                channels[topic], log_time=at, publish_time=at, data=text.encode(), sequence=number
            )
        writer.flush()
        writer.add_metadata("wall", {"wall_s": wall_s})
        writer.finish()


@pytest.mark.parametrize(
    ("topic", "key", "why"),
    [
        ("/unit/0/report", "controlled_ids", "controlled_ids must be robots'"),
        ("/unit/0/truth", "whole_ids", "whole_ids must be of markers"),
        ("/unit/0/truth", "found_ids", "found_ids must be of whole_ids"),
        ("/unit/0/goals", "ids", "ids must be of robots that were seen"),
    ],
)
def test_unknown_id_is_rejected(tmp_path, topic, key, why):
    """It is the last and largest of otherwise valid ids, so that the order stays."""
    path, strange = tmp_path / "run.mcap", []
    messages = recorded(load_mission("star", ["duration_s=0.2", "perception=ideal"]), path)
    for name, time_s, text in messages[1:]:
        record = json.loads(text)
        if name == topic:
            assert len(record[key]) > 1
            record[key][-1] = 999
        strange.append((name, time_s, json.dumps(record)))
    write(path, strange)
    with pytest.raises(InputError, match=why):
        read_recording(path)


def places(tree, at=()):
    """Return the paths to every value in a tree of JSON values."""
    yield at
    items = tree.items() if isinstance(tree, dict) else enumerate(tree[:4]) if isinstance(tree, list) else ()
    for key, value in items:
        yield from places(value, (*at, key))


def changed(text, rng):
    """Return a message's text with one value replaced, or one key or item removed, and a description."""
    tree = json.loads(text)
    ways = list(places(tree))
    way = ways[int(rng.integers(len(ways)))]
    nasty = NASTY[int(rng.integers(len(NASTY)))]
    if not way:
        return json.dumps(nasty), (way, nasty)
    node = tree
    for key in way[:-1]:
        node = node[key]
    if rng.random() < 0.2:
        del node[way[-1]]
        return json.dumps(tree), (way, "gone")
    node[way[-1]] = nasty
    return json.dumps(tree), (way, nasty)


def read_all(path):
    """Perform what verbs do with a recording."""
    recording = read_recording(path)
    history = make_history(recording.mission, recording.steps)
    json.dumps(summarize(history, recording.wall_s))
    judge_topology(
        {unit: history.ids[mine] for unit, mine in enumerate(history.controlled[-1])}, history.shape
    )
    find_topology_changes(history)
    stretch = last_stretch(history)
    measured_rate_ps(history.times_s[stretch], history.shape_error[stretch])


def check_change(messages, number, path):
    """Change one message; the mission is changed in every second case."""
    rng = np.random.default_rng([21, number])
    which = 0 if number % 2 else int(rng.integers(2, len(messages)))
    topic, time_s, text = messages[which]
    text, what = changed(text, rng)
    begin = messages[:1] if which else []
    write_changed = [*begin, *messages[2:]] if which else [(topic, time_s, text), *messages[2:]]
    if which:
        write_changed[which - 1] = (topic, time_s, text)
    write(path, write_changed)
    try:
        read_all(path)
    except InputError as refusal:
        said = str(refusal).replace(str(path), "run.mcap")
        assert "\n" not in said and len(said) < 500, (number, what, said)
        return True
    return False


def test_impossible_recording_is_rejected(messages, tmp_path):
    refused = sum(check_change(messages, number, tmp_path / "run.mcap") for number in range(24))
    assert refused > 6  # most others replaced a value by one that may be


@pytest.mark.parametrize("number", [1484, 2600])
def test_huge_positions_are_rejected_before_use(messages, tmp_path, number):
    """Centres at 1e300 px, whose squares overflow: NumPy would warn and continue."""
    check_change(messages, number, tmp_path / "run.mcap")


@pytest.mark.slow
def test_2000_altered_recordings(messages, tmp_path):
    for number in range(1000, 3000):
        check_change(messages, number, tmp_path / "run.mcap")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_report_of_100_altered_recordings(messages, tmp_path):
    """Includes figures and page of accepted recordings."""
    for number in range(100):
        try:
            if not check_change(messages, number, tmp_path / "run.mcap"):
                make_report(tmp_path)
        except InputError:
            pass


@pytest.mark.parametrize("wall_s", ["0.0", "0.25", "1.0", "86400.5"])
def test_wall_time_is_read_back(messages, tmp_path, wall_s):
    path = tmp_path / "run.mcap"
    write(path, [messages[0], *messages[2:]], wall_s=wall_s)
    assert read_recording(path).wall_s == float(wall_s)


def test_first_of_two_wrong_keys_is_named(messages, tmp_path):
    mission = json.loads(messages[0][2])
    mission["scenario"] |= {"step_s": -1, "goal": 3}
    write(tmp_path / "run.mcap", [(*messages[0][:2], json.dumps(mission)), *messages[2:]])
    with pytest.raises(InputError, match=r"another version of skyherd \(scenario: step_s: -1; a finite"):
        read_recording(tmp_path / "run.mcap")


@pytest.mark.parametrize("wall_s", ["x", "nan", "-1", "inf", "\0", "9" * 400])
def test_invalid_wall_time_is_unknown(messages, tmp_path, wall_s):
    path = tmp_path / "run.mcap"
    write(path, [messages[0], *messages[2:]], wall_s=wall_s)
    recording = read_recording(path)
    assert recording.whole and recording.wall_s is None


def test_invalid_json_and_topics_are_rejected(messages, tmp_path):
    path = tmp_path / "run.mcap"
    for text in ("{", "", "[" * 5000, "\ud800".encode("utf-8", "surrogatepass").decode("latin-1")):
        write(path, [messages[0], ("/world", 0.0, text), *messages[3:]])
        with pytest.raises(InputError, match="another version"):
            read_recording(path)
    mission = json.loads(messages[0][2])
    for topics in (mission["topics"][:1], 3, {"a": 1}):
        with path.open("wb") as stream:
            writer = Writer(stream, compression=CompressionType.ZSTD, enable_data_crcs=True)
            writer.start()
            for channel in range(9):
                writer.register_channel(f"/{channel}", "json", 0)
            text = json.dumps(mission | {"topics": topics}).encode()
            writer.add_message(1, log_time=0, publish_time=0, data=text, sequence=0)
            writer.add_message(9, log_time=0, publish_time=0, data=b"{}", sequence=1)
            writer.finish()
        with pytest.raises(InputError, match=r"another version|nothing was recorded"):
            read_recording(path)


def test_foreign_mcap_file_is_rejected(tmp_path):
    path = tmp_path / "theirs.mcap"
    for compression in (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD):
        with path.open("wb") as stream:
            writer = Writer(stream, compression=compression)
            writer.start()
            channel = writer.register_channel("/theirs", "json", 0)
            for _ in range(3):
                writer.add_message(channel, log_time=0, publish_time=0, data=b"{}")
            writer.finish()
        with pytest.raises(InputError, match="it cannot be read") as refusal:
            read_recording(path)
        assert "\n" not in str(refusal.value)
