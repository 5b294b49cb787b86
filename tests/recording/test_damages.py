"""Random damage of a recording: no traceback, never read as whole, and no excess loss.

The chunks hit by a damage follow from the original file. Every step of every other chunk must be read back
unchanged. The damages are drawn from a fixed seed: flipped bits and bytes, pieces overwritten, removed or
inserted, chunks swapped, repeated and removed, and truncated files. Each applies to a closed file and to one
whose writer was killed.
"""

import errno
import io
import os
import zlib
from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np
import pytest
import zstandard

from skyherd.datasets import load_mission
from skyherd.errors import InputError
from skyherd.loop import run_steps
from skyherd.recording.footer import MAGIC
from skyherd.recording.reader import MAX_BYTES, read_messages, read_recording, read_steps
from skyherd.recording.survey import Flaw, describe_flaws, survey
from skyherd.recording.writer import McapRecorder

CHUNK_OPCODE, CHUNK_HEAD = 6, 9 + 8 + 8 + 8 + 4 + 4 + 4 + 8
"""Opcode of a chunk, and bytes before its content: record, times, size, checksum, compression, length."""


CHECKSUM = 9 + 8 + 8 + 8
"""Byte of a chunk at which its checksum begins: after record, times and size."""


@dataclass
class Written:
    """An undamaged recording: its bytes, the positions of its chunks, and the steps in each."""

    data: bytes
    spans: list[tuple[int, int]]
    rows: list[list[int]]
    positions_m: list[np.ndarray]


def packed_length(data, start):
    return int.from_bytes(data[start + CHUNK_HEAD - 8 : start + CHUNK_HEAD], "little")


@pytest.fixture(scope="module")
def closed(tmp_path_factory) -> Written:
    """Return five seconds of six robots, two steps per chunk."""
    path = tmp_path_factory.mktemp("closed") / "run.mcap"
    mission = load_mission(
        "triangle", ["perception=ideal", "duration_s=5.0", "step_s=0.25", "units.*.frame_rate_hz=4.0"]
    )
    with McapRecorder(path, mission) as recorder:
        for step in run_steps(mission):
            recorder.write(step)
        recorder.finish(step.time_s, 1.5)
    data = path.read_bytes()
    chunks = survey(io.BytesIO(data)).chunks
    spans = [(c.start, c.start + CHUNK_HEAD + packed_length(data, c.start)) for c in chunks]
    recording = read_recording(path)
    times_s = [step.time_s for step in recording.steps]
    # The mission has the time of the first step, the end that of the last.
    rows = [[], []]
    for chunk in chunks[2:]:
        begun = sum(map(len, rows))
        rows.append([row for row in range(begun, 21) if chunk.first_s <= times_s[row] <= chunk.last_s])
    assert [row for some in rows for row in some] == list(range(21))
    return Written(data, spans, rows, [step.positions_m for step in recording.steps])


@pytest.fixture(scope="module")
def killed(closed) -> Written:
    """Return the same file without its end, as SIGKILL leaves it right after the last flush."""
    return Written(
        closed.data[: closed.spans[-2][1]], closed.spans[:-1], closed.rows[:-1], closed.positions_m
    )


def hit_by(written, low, high):
    """Return the numbers of the chunks that overlap the bytes from `low` to `high`."""
    return {n for n, (start, end) in enumerate(written.spans) if start < high and low < end}


def flip_bit(written, rng):
    at, data = int(rng.integers(len(written.data))), bytearray(written.data)
    data[at] ^= 1 << int(rng.integers(8))
    return bytes(data), hit_by(written, at, at + 1)


def flip_head_of_chunk(written, rng):
    number = int(rng.integers(len(written.spans)))
    at, data = written.spans[number][0] + int(rng.integers(CHUNK_HEAD)), bytearray(written.data)
    data[at] ^= 1 << int(rng.integers(8))
    return bytes(data), {number}


def flip_opcode_of_chunk(written, rng):
    number, data = int(rng.integers(len(written.spans))), bytearray(written.data)
    data[written.spans[number][0]] ^= 1 << int(rng.integers(8))
    return bytes(data), set()  # the chunk is found by its mark, and its checksum is right


def flip_end(written, rng):
    """Flip a bit in the metadata, the summary or the footer."""
    at, data = int(rng.integers(written.spans[-1][1], len(written.data))), bytearray(written.data)
    data[at] ^= 1 << int(rng.integers(8))
    return bytes(data), set()


def overwrite(written, rng):
    at, size = int(rng.integers(len(written.data))), int(rng.integers(1, 2000))
    noise = rng.bytes(min(size, len(written.data) - at))
    return written.data[:at] + noise + written.data[at + len(noise) :], hit_by(written, at, at + len(noise))


def cut_out(written, rng):
    at, size = int(rng.integers(len(written.data) - 1)), int(rng.integers(1, 60_000))
    return written.data[:at] + written.data[at + size :], hit_by(written, at, at + size)


def put_in(written, rng):
    at, noise = int(rng.integers(1, len(written.data))), rng.bytes(int(rng.integers(1, 5000)))
    hit = {n for n, (start, end) in enumerate(written.spans) if start < at < end}
    return written.data[:at] + noise + written.data[at:], hit


def break_off(written, rng):
    at = int(rng.integers(len(written.data) - 1))
    return written.data[:at], hit_by(written, at, len(written.data))


def cut_chunk(written, rng):
    number = int(rng.integers(len(written.spans)))
    start, end = written.spans[number]
    return written.data[:start] + written.data[end:], {number}


def repeat_chunk(written, rng):
    """Insert a copy of a chunk between two chunks."""
    start, end = written.spans[int(rng.integers(len(written.spans)))]
    at = written.spans[int(rng.integers(len(written.spans)))][0]
    return written.data[:at] + written.data[start:end] + written.data[at:], set()


def swap_chunks(written, rng):
    first, second = sorted(rng.choice(len(written.spans), size=2, replace=False).tolist())
    (a, b), (c, d) = written.spans[first], written.spans[second]
    data = written.data
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:], set()


DAMAGES = (
    flip_bit,
    flip_head_of_chunk,
    flip_opcode_of_chunk,
    flip_end,
    overwrite,
    cut_out,
    put_in,
    break_off,
    cut_chunk,
    repeat_chunk,
    swap_chunks,
)


def check_damage(written, number, path):
    """Damage a recording by a numbered method, and check the data read from it."""
    rng = np.random.default_rng([20, number])
    kind = DAMAGES[number % len(DAMAGES)]
    if kind is flip_end and len(written.data) == written.spans[-1][1]:
        kind = flip_bit
    data, hit = kind(written, rng)
    path.write_bytes(data)
    expected = [row for n, rows in enumerate(written.rows) if n not in hit for row in rows]
    try:
        recording = read_recording(path)
    except InputError as refusal:
        # Nothing can be read without the mission, and there is no run without a step.
        assert {0, 1} <= hit or not expected, (kind.__name__, number, str(refusal))
        assert len(str(refusal)) < 500 + len(str(path)) and "\n" not in str(refusal)
        return
    assert not recording.whole, (kind.__name__, number)
    assert len(describe_flaws(recording.flaws)) < 300
    rows = [round(step.time_s / 0.25) for step in recording.steps]
    assert rows == sorted(set(rows))
    assert set(expected) <= set(rows), (kind.__name__, number, describe_flaws(recording.flaws))
    for row, step in zip(rows, recording.steps, strict=True):
        np.testing.assert_array_equal(step.positions_m, written.positions_m[row])


def test_damage_is_reported_and_costs_only_hit_chunks(closed, tmp_path):
    for number in range(66):
        check_damage(closed, number, tmp_path / "run.mcap")


@pytest.mark.slow
def test_thousand_random_damages(closed, killed, tmp_path):
    for written in (closed, killed):
        for number in range(500):
            if written is killed and DAMAGES[number % len(DAMAGES)] is break_off:
                continue  # that is another killed run, which nothing can tell
            check_damage(written, 1000 + number, tmp_path / "run.mcap")


def test_undamaged_file_is_whole(closed, tmp_path):
    path = tmp_path / "run.mcap"
    path.write_bytes(closed.data)
    recording = read_recording(path)
    assert recording.whole and recording.wall_s == 1.5 and len(recording.steps) == 21


def flaws_of(data, path):
    path.write_bytes(data)
    recording = read_recording(path)
    return [flaw.kind for flaw in recording.flaws], len(recording.steps)


def test_flaw_kinds_are_distinguished(closed, killed, tmp_path):
    path, (start, end) = tmp_path / "run.mcap", closed.spans[6]
    lost, data = len(closed.rows[6]), closed.data
    assert flaws_of(data[:start] + data[end:], path) == (["missing"], 21 - lost)
    # One bit of the chunk's content, and one of its opcode, which no chunk checksum covers.
    inside = bytearray(data)
    inside[(start + end) // 2] ^= 1
    assert flaws_of(bytes(inside), path) == (["damaged", "missing"], 21 - lost)
    opcode = bytearray(data)
    opcode[start] ^= 1
    assert flaws_of(bytes(opcode), path) == (["damaged"], 21)
    (begin, last), ending = closed.spans[-1], len(closed.rows[-1])
    assert flaws_of(data[:begin] + data[last:], path) == (["missing"], 21 - ending)
    assert flaws_of(killed.data, path) == (["cut short"], 21 - len(closed.rows[-1]))
    assert flaws_of(data[: (start + end) // 2], path)[0] == ["cut short"]
    assert flaws_of(data[:-1], path) == (["cut short"], 21)
    assert flaws_of(data + b"\0", path) == (["cut short"], 21)
    footer = bytearray(data)
    footer[-len(MAGIC) - 1] ^= 1
    assert flaws_of(bytes(footer), path) == (["damaged"], 21)
    assert flaws_of(data[:end] + data[start:], path) == (["repeated"], 21)
    (a, b), (c, d) = closed.spans[5], closed.spans[6]
    swapped = data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]
    assert flaws_of(swapped, path) == (["misplaced"], 21)


def test_any_flipped_bit_of_footer_is_detected(closed, tmp_path):
    """A bit of each byte of the metadata, the closing record, the summary and the footer."""
    for at in range(closed.spans[-1][1], len(closed.data), 7):
        data = bytearray(closed.data)
        data[at] ^= 1 << (at % 8)
        assert survey(io.BytesIO(bytes(data))).flaws, at


def test_changed_end_mark_is_detected(closed, tmp_path):
    """No checksum covers the mark: neither smaller nor greater values are accepted."""
    for at in range(-len(MAGIC), 0):
        for by in (-1, 1):
            data = bytearray(closed.data)
            data[at] = (data[at] + by) % 256
            assert flaws_of(bytes(data), tmp_path / "run.mcap") == (["cut short"], 21)


def test_interrupted_run_has_intact_file_without_end(closed, tmp_path):
    """As after Ctrl-C: the file is closed, and states that the run did not end."""
    path = tmp_path / "run.mcap"
    mission = load_mission("triangle", ["perception=ideal"])
    with McapRecorder(path, mission) as recorder:
        for step in islice(run_steps(mission), 4):
            recorder.write(step)
    recording = read_recording(path)
    assert not recording.ended and not recording.whole and recording.wall_s is None
    assert [str(flaw) for flaw in recording.flaws] == ["cut short: after 0.3 s"]
    assert not survey(io.BytesIO(path.read_bytes())).ended
    assert survey(io.BytesIO(closed.data)).ended


def test_flaws_are_one_line_and_fourth_is_counted():
    flaws = [Flaw("damaged", f"the chunk at byte {start}") for start in range(5)]
    three = "; ".join(f"damaged: the chunk at byte {start}" for start in range(3))
    assert describe_flaws(flaws[:1]) == "damaged: the chunk at byte 0"
    assert describe_flaws(flaws[:3]) == three
    assert describe_flaws(flaws[:4]) == f"{three}; and 1 more"
    assert describe_flaws(flaws) == f"{three}; and 2 more"


def test_read_failure_is_one_line(closed, tmp_path, monkeypatch):
    def fail(stream):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("skyherd.recording.reader.survey", fail)
    (tmp_path / "run.mcap").write_bytes(closed.data)
    with pytest.raises(InputError, match=r"run\.mcap: Input/output error; a recording"):
        read_recording(tmp_path / "run.mcap")


def test_mission_is_read_from_its_copy(closed, tmp_path):
    for number in (0, 1):
        start, end = closed.spans[number]
        kinds, steps = flaws_of(closed.data[:start] + closed.data[end:], tmp_path / "run.mcap")
        assert (kinds, steps) == (["missing"], 21)
    path = tmp_path / "run.mcap"
    path.write_bytes(closed.data[: closed.spans[0][0]] + closed.data[closed.spans[1][1] :])
    with pytest.raises(InputError, match="its mission is missing"):
        read_recording(path)


@pytest.mark.parametrize("content", [b"", MAGIC])
def test_run_killed_at_once_has_no_record(tmp_path, content):
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match="nothing was recorded yet"):
        read_recording(path)


def test_mission_without_step_has_no_record(closed, tmp_path):
    path = tmp_path / "run.mcap"
    path.write_bytes(closed.data[: closed.spans[1][1]])
    with pytest.raises(InputError, match="nothing was recorded yet"):
        read_recording(path)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (".", "is a folder"),
        ("pipe", "is a pipe"),
        ("/dev/zero", "is a device"),
        ("loop", "symbolic links"),
        ("a\0b", "no file can have this name"),
        ("none", "no such file"),
        ("large", "at most 64 GiB are read"),
    ],
)
def test_non_regular_recording_is_rejected(tmp_path, name, said):
    """A non-regular file neither blocks nor is read without end."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "large").touch()
    with (tmp_path / "large").open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    for read in (read_recording, lambda path: next(read_messages(path)), lambda path: next(read_steps(path))):
        with pytest.raises(InputError, match=said):
            read(tmp_path / name)


def test_chunk_has_whole_steps_of_half_a_second(closed):
    assert all(closed.rows[2:-1])
    assert max(len(rows) for rows in closed.rows) <= 2
    assert all(after[0] == before[-1] + 1 for before, after in pairwise(closed.rows[2:-1]))


def test_steps_with_images_are_read_around_damage(closed, tmp_path):
    path, (start, end) = tmp_path / "run.mcap", closed.spans[6]
    path.write_bytes(closed.data[:start] + closed.data[end:])
    assert [s.time_s for s in read_steps(path)] == [s.time_s for s in read_recording(path).steps]


def test_chunks_are_found_at_any_block_boundary(closed, monkeypatch):
    """A block may end within the mark of a chunk, or right before it."""
    begun = [start for start, _ in closed.spans[:4]]
    head = closed.data[: closed.spans[3][1]]
    for size in (7, 40, *range(begun[1] + 20, begun[1] + 60)):
        monkeypatch.setattr("skyherd.recording.survey.BLOCK", size)
        assert [chunk.start for chunk in survey(io.BytesIO(head)).chunks] == begun


@pytest.mark.parametrize("is_changed", [False, True])
@pytest.mark.parametrize("is_checked", [False, True])
def test_chunk_without_checksum_is_never_read(closed, is_changed, is_checked):
    """MCAP has 0 for a chunk that has no checksum: nothing tells then whether it is as it was written."""
    start, end = closed.spans[3]
    plain = bytearray(zstandard.decompress(closed.data[start + CHUNK_HEAD : end]))
    if is_changed:
        at = plain.index(b".", plain.index(b'"positions_m"')) + 1
        plain[at] = ord("5") if plain[at] != ord("5") else ord("6")
    packed = zstandard.compress(bytes(plain))
    head = bytearray(closed.data[start : start + CHUNK_HEAD])
    head[1:9] = (CHUNK_HEAD - 9 + len(packed)).to_bytes(8, "little")
    head[CHECKSUM : CHECKSUM + 4] = (zlib.crc32(plain) if is_checked else 0).to_bytes(4, "little")
    head[-8:] = len(packed).to_bytes(8, "little")
    found = survey(io.BytesIO(closed.data[:start] + head + packed + closed.data[end:]))
    assert (start in {chunk.start for chunk in found.chunks}) == is_checked
    assert any(flaw.where == f"the chunk at byte {start}" for flaw in found.flaws) == (not is_checked)
