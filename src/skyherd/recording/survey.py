"""Integrity survey of a recording: its readable chunks and its flaws.

A recording proves its integrity: every chunk, the data and the footer have checksums, the messages are
numbered consecutively, and the footer has their count. Damaged files are read as far as possible.

A chunk is located by its mark and not by the lengths of the records before it, so that damage in one place
hides nothing in another. Its checksum then shows whether it is intact, and the numbers of its messages show
its position. Swapped chunks are read in order, repeated chunks are read once, and lost chunks are reported.
"""

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import BinaryIO, Literal, NamedTuple

import zstandard
from mcap.records import Chunk, Message
from mcap.stream_reader import breakup_chunk

from skyherd.recording.footer import MAGIC, MALFORMED, find_footer

MAX_CHUNK = 2**30
"""Maximum size of an unpacked chunk, bytes. Chosen: a step of a hundred images of 10 MB as JPEG; a few bytes
that claim terabytes must not fill the memory."""

BLOCK = 2**20
"""Bytes that are searched at a time. Chosen: half and twice of it take the same time."""

SHOWN_FLAWS = 3
"""Maximum number of flaws named in a message; the others are counted. Chosen: fits a line."""

_CHUNK = struct.Struct("<BQQQQII4sQ")
"""Start of a chunk: opcode, length, first and last time, size and checksum of the content, length and name of
the compression, and packed length."""

_MARK = struct.pack("<I4s", 4, b"zstd")
"""Length and name of the compression, by which a chunk is located."""

_BEFORE_MARK = struct.calcsize("<BQQQQI")
_FRAME = b"\x28\xb5\x2f\xfd"
"""First bytes of zstd data."""


@dataclass(frozen=True)
class Flaw:
    """A defect of a recording.

    Attributes:
        kind: `cut short` where the end is missing, as of a killed or unfinished run; `missing` where messages
            between others are lost; `damaged` where bytes have changed; `repeated` and `misplaced` for
            duplicate chunks, or chunks out of order.
        where: a description of a few words.
    """

    kind: Literal["cut short", "missing", "damaged", "repeated", "misplaced"]
    where: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.where}"


def describe_flaws(flaws: Sequence[Flaw]) -> str:
    """Describe the flaws in one line: the first `SHOWN_FLAWS`, and the number of others."""
    more = f"; and {len(flaws) - SHOWN_FLAWS} more" if len(flaws) > SHOWN_FLAWS else ""
    return "; ".join(map(str, flaws[:SHOWN_FLAWS])) + more


class SoundChunk(NamedTuple):
    """An intact chunk.

    Attributes:
        start: byte of the file at which it begins.
        first: number of its first message.
        after: number after that of its last message.
        first_s: time of its first message.
        last_s: time of its last message.
    """

    start: int
    first: int
    after: int
    first_s: float
    last_s: float


@dataclass(frozen=True)
class Survey:
    """Readable content of a file.

    Attributes:
        chunks: the intact chunks in the order of their messages, without duplicates.
        flaws: defects of the file.
        ended: True if the file's footer states that the run ended normally.
    """

    chunks: tuple[SoundChunk, ...]
    flaws: tuple[Flaw, ...]
    ended: bool


def survey(stream: BinaryIO) -> Survey:
    """Find the readable chunks of a recording, and its flaws."""
    size = stream.seek(0, 2)
    footer = find_footer(stream, size)
    data_end = footer.data_end if footer else size
    crc, marks = _search(stream, data_end)
    sound: list[SoundChunk] = []
    flaws: list[Flaw] = []
    for start in (mark - _BEFORE_MARK for mark in marks if mark >= _BEFORE_MARK):
        try:
            sound.append(_sound_chunk(start, read_chunk(stream, start)))
        except MALFORMED:
            breaks_off = footer is None and start + _length(stream, start) > size
            if not breaks_off:
                flaws.append(Flaw("damaged", f"the chunk at byte {start}"))
    chunks, misfits = _in_order(sound, footer.messages if footer else None)
    flaws += misfits
    if footer is None:
        closed = stream.seek(max(size - len(MAGIC), 0)) and stream.read() == MAGIC
        last_s = f"after {chunks[-1].last_s:.6g} s" if chunks else "at the beginning"
        flaws.append(Flaw("damaged", "the footer") if closed else Flaw("cut short", last_s))
    elif crc != footer.data_crc and not flaws:
        flaws.append(Flaw("damaged", "bytes without a message"))
    return Survey(tuple(chunks), tuple(flaws), footer is not None and footer.ended)


def read_chunk(stream: BinaryIO, start: int) -> list[Message]:
    """Return the messages of the chunk that begins at a byte of the file.

    In MCAP, a checksum of 0 means a missing one. All chunks of ours have one, so that such a chunk is
    refused: nothing tells whether it is as it was written.

    Raises:
        MALFORMED: its checksum fails, or skyherd did not write it.
    """
    stream.seek(start)
    head = stream.read(_CHUNK.size)
    *_, crc, _, _, packed_length = _CHUNK.unpack(head)
    if crc == 0 or packed_length > MAX_CHUNK:
        raise ValueError("no checksum, or too large")
    packed = stream.read(packed_length)
    size = zstandard.get_frame_parameters(packed).content_size
    if not 0 < size <= MAX_CHUNK:
        raise ValueError("no size, or too large")
    chunk = Chunk(
        compression="zstd",
        data=packed,
        message_start_time=0,
        message_end_time=0,
        uncompressed_crc=crc,
        uncompressed_size=size,
    )
    messages = [r for r in breakup_chunk(chunk, validate_crc=True) if isinstance(r, Message)]
    numbers = [message.sequence for message in messages]
    if not messages or numbers != list(range(numbers[0], numbers[0] + len(numbers))):
        raise ValueError("its messages are not numbered consecutively")
    return messages


def _length(stream: BinaryIO, start: int) -> int:
    """Return the stated length of the chunk at a byte of the file, bytes."""
    stream.seek(start)
    head = stream.read(_CHUNK.size)
    return _CHUNK.size + int(_CHUNK.unpack(head)[-1]) if len(head) == _CHUNK.size else _CHUNK.size


def _sound_chunk(start: int, messages: list[Message]) -> SoundChunk:
    first, last = messages[0], messages[-1]
    return SoundChunk(start, first.sequence, last.sequence + 1, first.log_time / 1e9, last.log_time / 1e9)


def _in_order(sound: list[SoundChunk], total: int | None) -> tuple[list[SoundChunk], list[Flaw]]:
    """Return the chunks in the order of their messages without duplicates, and the flaws found."""
    chunks: list[SoundChunk] = []
    flaws: list[Flaw] = []
    expected, since = 0, "at the beginning"
    for chunk in sorted(sound, key=lambda chunk: (chunk.first, chunk.start)):
        if chunk.first < expected:
            flaws.append(Flaw("repeated", f"the chunk at byte {chunk.start}"))
            continue
        if chunk.first > expected:
            flaws.append(Flaw("missing", f"{chunk.first - expected} messages {since}"))
        if chunks and chunk.start < chunks[-1].start:
            flaws.append(Flaw("misplaced", f"the chunk at byte {chunk.start}"))
        chunks.append(chunk)
        expected, since = chunk.after, f"after {chunk.last_s:.6g} s"
    if total is not None and expected != total:
        flaws.append(Flaw("missing", f"{abs(total - expected)} messages {since}"))
    return chunks, flaws


def _search(stream: BinaryIO, end: int) -> tuple[int, list[int]]:
    """Return the checksum of the bytes before `end`, and the positions of chunk marks in them."""
    crc, marks, at, tail = 0, list[int](), 0, b""
    mark_size = len(_MARK) + 8 + len(_FRAME)
    stream.seek(0)
    while block := stream.read(min(BLOCK, end - at)):
        crc = zlib.crc32(block, crc)
        window, origin = tail + block, at - len(tail)
        found = window.find(_MARK)
        while found >= 0:
            if window.startswith(_FRAME, found + len(_MARK) + 8):
                marks.append(origin + found)
            found = window.find(_MARK, found + 1)
        at += len(block)
        tail = window[-(mark_size - 1) :]
    return crc, marks
