"""Footer of a recording: its statements on the data before it, wherever it lies."""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from itertools import islice
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Statistics

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of an MCAP file."""

HEAD_CHANNEL, END_CHANNEL = 1, 2
"""Channel numbers of the head and of `/end`. The head, `/mission` of a run and `/about` of a live process,
names the topics of all channels in order, so that any chunk can be decoded with it."""

SEARCHED_END = 2**26
"""Bytes at the end of a file that are searched for its summary. Chosen: fits the summary of a day's run."""

FOOTER_TRIES = 16
"""Maximum number of candidate positions of the summary. Chosen: one is right in a valid file; the searched
bytes may occur in the summary by chance."""

_RECORD = struct.Struct("<BQ")
"""Start of every record: opcode and length."""

_DATA_END = struct.Struct("<BQI")
_FOOTER = struct.Struct("<BQQQI")
"""Records that close the data and the file: opcode, length, and checksum as the last number."""

_DATA_END_HEAD = _RECORD.pack(Opcode.DATA_END, 4)

MALFORMED = (McapError, zstandard.ZstdError, struct.error, ValueError, KeyError, OverflowError)
"""Exceptions of unpacking and parsing arbitrary bytes."""


class Footer(NamedTuple):
    """Content of a file's footer.

    Attributes:
        data_end: byte at which the data end.
        data_crc: checksum of the data.
        messages: number of messages.
        ended: True if the run ended normally.
    """

    data_end: int
    data_crc: int
    messages: int
    ended: bool


def find_footer(stream: BinaryIO, size: int) -> Footer | None:
    """Find the footer at the end of the file; None if it is missing or damaged.

    It lies at its recorded position. If bytes were removed from the data, it lies where its checksum matches.
    """
    closing_size = _FOOTER.size + len(MAGIC)
    if size < len(MAGIC) + _DATA_END.size + closing_size:
        return None
    origin = max(size - SEARCHED_END, 0)
    stream.seek(origin)
    end = stream.read(size - origin)
    footer = end[-closing_size : -len(MAGIC)]
    opcode, _, summary_start, _, crc = _FOOTER.unpack(footer)
    if end[-len(MAGIC) :] != MAGIC or opcode != Opcode.FOOTER:
        return None
    for at in islice(_closings(end, summary_start - _DATA_END.size - origin), FOOTER_TRIES):
        summary = end[at + _DATA_END.size : -closing_size]
        if zlib.crc32(footer[:-4], zlib.crc32(summary)) == crc:
            return _read_footer(origin + at, end[at : at + _DATA_END.size], summary)
    return None


def _closings(end: bytes, told: int) -> Iterator[int]:
    """Return candidate positions of the data-end record: the recorded one, then from the end backwards."""
    if 0 <= told < len(end):
        yield told
    at = end.rfind(_DATA_END_HEAD)
    while at >= 0:
        yield at
        at = end.rfind(_DATA_END_HEAD, 0, at)


def _read_footer(data_end: int, closing: bytes, summary: bytes) -> Footer | None:
    """Read the footer after data that end at a byte: the data-end record and the summary."""
    counts = [record for record in _records(summary) if record[0] == Opcode.STATISTICS]
    if not closing.startswith(_DATA_END_HEAD) or len(counts) != 1:
        return None
    try:
        statistics = Statistics.read(ReadDataStream(BytesIO(counts[0][1])))
    except MALFORMED:
        return None
    return Footer(
        data_end=data_end,
        data_crc=_DATA_END.unpack(closing)[-1],
        messages=statistics.message_count,
        ended=statistics.channel_message_counts.get(END_CHANNEL, 0) > 0,
    )


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of consecutive records."""
    at = 0
    while at + _RECORD.size <= len(data):
        opcode, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size + length
        yield opcode, data[at - length : at]
