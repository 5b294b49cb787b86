"""What of a recording's file can be read, and what it lacks.

A recording proves that it is whole: every chunk has a checksum, so have the data and the footer, the messages
are numbered through, and the footer says how many there are. What is not whole is read as far as it goes.
A chunk is found by its mark, wherever it lies, and not by the lengths of the records before it, so that
damage in one place hides nothing in another. Its checksum then says whether it is as it was written, and the
numbers of its messages where it belongs: chunks that were swapped are read in order, chunks that were
repeated are read once, and chunks that are gone are missed.
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
"""Largest chunk that is unpacked, bytes. Chosen: a step of a hundred images of 10 MB as JPEG; beyond it a
few bytes that claim to be terabytes would take all memory."""

BLOCK = 2**20
"""Bytes that are searched at a time. Chosen: half and twice of it take the same time."""

SHOWN_FLAWS = 3
"""Flaws that a message names; the others are counted. Chosen: what fits into a line."""

_CHUNK = struct.Struct("<BQQQQII4sQ")
"""Beginning of a chunk: opcode, length, first and last time, size and checksum of what is packed, length and
name of the compression, and the packed length."""

_MARK = struct.pack("<I4s", 4, b"zstd")
"""Length and name of the compression, by which a chunk is found."""

_BEFORE_MARK = struct.calcsize("<BQQQQI")
_FRAME = b"\x28\xb5\x2f\xfd"
"""First bytes of what zstd packed."""


@dataclass(frozen=True)
class Flaw:
    """Something that is wrong with a recording.

    Attributes:
        kind: `cut short` where the end is not there, as of a run that was killed or still goes on; `missing`
            where messages between others are gone; `damaged` where bytes are not as they were written;
            `repeated` and `misplaced` for chunks that are there twice, or not in the order of time.
        where: what is so, in a few words.
    """

    kind: Literal["cut short", "missing", "damaged", "repeated", "misplaced"]
    where: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.where}"


def describe_flaws(flaws: Sequence[Flaw]) -> str:
    """The flaws in one line: the first `SHOWN_FLAWS`, and how many there are beside them."""
    more = f"; and {len(flaws) - SHOWN_FLAWS} more" if len(flaws) > SHOWN_FLAWS else ""
    return "; ".join(map(str, flaws[:SHOWN_FLAWS])) + more


class SoundChunk(NamedTuple):
    """A chunk that is as it was written.

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
    """What of a file can be read.

    Attributes:
        chunks: the sound chunks in the order of their messages, none twice.
        flaws: what is wrong with the file.
        ended: whether the file's footer says that the run came to its end.
    """

    chunks: tuple[SoundChunk, ...]
    flaws: tuple[Flaw, ...]
    ended: bool


def survey(stream: BinaryIO) -> Survey:
    """Find what can be read of a recording, and what is wrong with it."""
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
        flaws.append(Flaw("damaged", "bytes that hold no message"))
    return Survey(tuple(chunks), tuple(flaws), footer is not None and footer.ended)


def read_chunk(stream: BinaryIO, start: int) -> list[Message]:
    """The messages of the chunk that begins at a byte of the file.

    A checksum of 0 means in MCAP that there is none. All chunks of ours have one, so that such a chunk is
    refused: nothing tells whether it is as it was written.

    Raises:
        MALFORMED: its checksum fails, or it is none of ours.
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
        raise ValueError("its messages are not numbered through")
    return messages


def _length(stream: BinaryIO, start: int) -> int:
    """Bytes of the chunk that begins at a byte of the file, as it says itself."""
    stream.seek(start)
    head = stream.read(_CHUNK.size)
    return _CHUNK.size + int(_CHUNK.unpack(head)[-1]) if len(head) == _CHUNK.size else _CHUNK.size


def _sound_chunk(start: int, messages: list[Message]) -> SoundChunk:
    first, last = messages[0], messages[-1]
    return SoundChunk(start, first.sequence, last.sequence + 1, first.log_time / 1e9, last.log_time / 1e9)


def _in_order(sound: list[SoundChunk], total: int | None) -> tuple[list[SoundChunk], list[Flaw]]:
    """Chunks in the order of their messages, without those that come again, and what that shows of flaws."""
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
    """Checksum of the bytes before `end`, and where marks of chunks lie in them."""
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
