"""Incremental MCAP writer; a killed process loses only the end of its file."""

import math
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from skyherd.messages import TIME_TOLERANCE_S
from skyherd.recording.json_codec import json_schema, to_json
from skyherd.version import __version__

CHUNK_BYTES = 1 << 16
"""Size of pending messages at which a chunk is written early, bytes. Chosen: smaller chunks compress worse,
larger ones lose more when damaged."""

FLUSH_S = 0.5
"""Longest time span of the messages that a killed process loses, s. Chosen: robots move little in it, and
shorter chunks compress worse."""

Schema = tuple[str, type | dict[str, Any]]
"""Name of a schema, and its dataclass or JSON schema."""


class McapLog:
    """Numbered JSON messages with schemas, in checksummed chunks that end at `flush`.

    Attributes:
        topics: topics and their schemas. All are registered at the start, numbered from 1, so that no chunk
            depends on another.
        pending_bytes: size of the data since the last `flush`, which is lost if the process is killed.

    Args:
        path: the file to create; an existing one is replaced.
        topics: topics and their schemas.

    Raises:
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path, topics: Mapping[str, Schema]) -> None:
        self.topics, self.pending_bytes = topics, 0
        self._flushed_s = -math.inf
        self._file = path.open("wb")
        # Only `flush` ends a chunk, so that messages that belong together share one.
        self._writer = Writer(
            self._file, chunk_size=sys.maxsize, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        self._writer.start(library=f"skyherd {__version__}")
        self._sequence = 0
        schemas: dict[str, int] = {}
        for name, content in topics.values():
            if name not in schemas:
                text = to_json(content if isinstance(content, dict) else json_schema(content))
                schemas[name] = self._writer.register_schema(name, "jsonschema", text)
        self._channels = {
            topic: self._writer.register_channel(topic, "json", schemas[name])
            for topic, (name, _) in topics.items()
        }

    def put(self, topic: str, time_s: float, record: Any) -> None:
        """Append a message with the next number."""
        at, data = nanoseconds(time_s), to_json(record)
        self._writer.add_message(
            self._channels[topic], log_time=at, publish_time=at, data=data, sequence=self._sequence
        )
        self._sequence += 1
        self.pending_bytes += len(data)

    def flush_when_due(self, now_s: float, next_s: float | None = None) -> None:
        """Write a chunk if a kill could otherwise lose more than `FLUSH_S` or `CHUNK_BYTES`.

        Call it after messages that belong together. A clock that goes back makes a chunk due.

        Args:
            now_s: time of the last message, s.
            next_s: time of the next call, s; `now_s` if None.
        """
        age_s = (now_s if next_s is None else next_s) - self._flushed_s
        if self.pending_bytes >= CHUNK_BYTES or not 0 <= age_s <= FLUSH_S + TIME_TOLERANCE_S:
            self.flush()
            self._flushed_s = now_s

    def flush(self) -> None:
        """Write pending messages as a chunk, which then survives a kill of the process."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._file.flush()
        self.pending_bytes = 0

    def add_metadata(self, name: str, texts: dict[str, str]) -> None:
        """Add texts to the file as metadata, not as a message."""
        self._writer.add_metadata(name, texts)

    def abandon(self) -> None:
        """Close the file without its end, after a failed write."""
        with suppress(OSError):
            self._file.close()

    def close(self) -> None:
        """Write the end of the file, and close it."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._file.close()


def nanoseconds(time_s: float) -> int:
    """Return a time in s as integer nanoseconds, the unit of MCAP."""
    return round(time_s * 1e9)
