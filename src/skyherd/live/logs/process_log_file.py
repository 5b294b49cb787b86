"""Reading of a process's recording, also of a damaged one."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import orjson

from skyherd.errors import InputError
from skyherd.files.reading import open_regular
from skyherd.live.wire import VERSION
from skyherd.recording.footer import HEAD_CHANNEL, MALFORMED
from skyherd.recording.survey import describe_flaws, read_chunk, survey
from skyherd.text import printable, shorten

ALLOWED = "a file of `skyherd live run`"
"""Expected input, for error messages."""

MAX_BYTES = 2**36
"""Size of the largest accepted file, bytes. Chosen: as for recordings of simulated runs."""

MALFORMED_RECORDS = (*MALFORMED, InputError, TypeError, AttributeError, IndexError, FloatingPointError)
"""Errors from records that this version of skyherd did not write."""


class Entry(NamedTuple):
    """One record of a file.

    Attributes:
        number: number of the record in the file, from 0. Gaps are lost records.
        topic: as in `skyherd.live.logs.process_log`.
        content: dict, list, str, int, float, bool, None.
    """

    number: int
    topic: str
    content: Any


class ProcessLogFile:
    """Recording of one process: its records and flaws.

    Attributes:
        path: the file.
        flaws: flaws of the file; empty if it is complete.
        ended: whether the process ended in order.

    Raises:
        InputError: the file does not exist, or has no readable record of a live process.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with open_regular(path, ALLOWED, MAX_BYTES) as stream:
            try:
                found = survey(stream)
            except OSError as error:
                raise InputError(str(path), error.strerror or str(error), ALLOWED) from None
        self.flaws, self.ended, self._chunks = found.flaws, found.ended, found.chunks
        self._topics = self._read_topics()

    def entries(self) -> Iterator[Entry]:
        """Yield the readable records in order.

        Raises:
            MALFORMED_RECORDS: a record does not have this version's format.
        """
        with open_regular(self.path, ALLOWED, MAX_BYTES) as stream:
            for chunk in self._chunks:
                for message in read_chunk(stream, chunk.start):
                    topic = self._topics[message.channel_id]
                    yield Entry(message.sequence, topic, orjson.loads(message.data))

    def _read_topics(self) -> dict[int, str]:
        """Return the topics by channel number, from the first record."""
        with open_regular(self.path, ALLOWED, MAX_BYTES) as stream:
            try:
                first = read_chunk(stream, self._chunks[0].start)[0]
                if first.channel_id == HEAD_CHANNEL:
                    topics = orjson.loads(first.data)["topics"]
                    return {HEAD_CHANNEL + row: str(topic) for row, topic in enumerate(topics)}
            except MALFORMED_RECORDS:
                pass
        why = f" ({describe_flaws(self.flaws)})" if self.flaws else ""
        raise InputError(str(self.path), f"no readable record of a live process{why}", ALLOWED)


def check_format(about: dict[str, Any], path: Path) -> None:
    """Refuse a recording in another format, whose decision rules may differ.

    Raises:
        InputError: the record `/about` has another format, or none.
    """
    if (found := about.get("format", 2)) != VERSION:
        raise InputError(
            str(path),
            f"recorded in format {shorten(printable(str(found)), 30)}",
            f"format {VERSION}; replay older recordings with the version of skyherd that made them",
        )


def read_process_log(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield topic and content of a process's records, up to the first missing one.

    Raises:
        InputError: the file does not exist, or has no readable record of a live process.
    """
    for expected, entry in enumerate(ProcessLogFile(path).entries()):
        if entry.number != expected:
            return
        yield entry.topic, entry.content
