"""The end of a recording's file: what it says of the data before it, wherever it lies."""

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
"""Numbers of the channels of the head and of `/end`. The head, `/mission` of a run and `/about` of a live
process, names the topics of all channels in their order, so that any chunk can be understood by it."""

SEARCHED_END = 2**26
"""Bytes at the end of a file in which its summary is looked for. Chosen: room for that of a day's run."""

FOOTER_TRIES = 16
"""Places that are tried for the beginning of the summary. Chosen: one is right in a file of ours; the bytes
that are searched for may be in the summary by chance as well."""

_RECORD = struct.Struct("<BQ")
"""Beginning of every record: opcode and length."""

_DATA_END = struct.Struct("<BQI")
_FOOTER = struct.Struct("<BQQQI")
"""The records that close the data and the file: opcode, length, and the last number a checksum."""

_DATA_END_HEAD = _RECORD.pack(Opcode.DATA_END, 4)

MALFORMED = (McapError, zstandard.ZstdError, struct.error, ValueError, KeyError, OverflowError)
"""What unpacking and parsing raise for bytes that nobody wrote."""


class Footer(NamedTuple):
    """What the end of a file says.

    Attributes:
        data_end: byte at which the data end.
        data_crc: their checksum.
        messages: how many there are.
        ended: whether the run came to its end.
    """

    data_end: int
    data_crc: int
    messages: int
    ended: bool


def find_footer(stream: BinaryIO, size: int) -> Footer | None:
    """What the end of the file says, None where there is none or it is not as it was written.

    It lies where the footer has it, or, if bytes were cut out of the data, wherever its checksum is right.
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
    """Where in the end of a file the record may be that closes the data: as told, then from the last back."""
    if 0 <= told < len(end):
        yield told
    at = end.rfind(_DATA_END_HEAD)
    while at >= 0:
        yield at
        at = end.rfind(_DATA_END_HEAD, 0, at)


def _read_footer(data_end: int, closing: bytes, summary: bytes) -> Footer | None:
    """The footer of data that end at a byte, from the record that closes them and the summary after it."""
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
    """Opcode and content of records that lie one after the other."""
    at = 0
    while at + _RECORD.size <= len(data):
        opcode, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size + length
        yield opcode, data[at - length : at]
