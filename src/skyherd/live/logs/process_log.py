"""What one process hears, reads from its clock and does, as it happens, in an MCAP file of its own.

Every input is there in the order in which it came, so that `skyherd.live.logs.replay` decides anew from
it:

    /about       first, and once more: who it is, the lab as it was checked, the versions, and the topics
    /heard       a message: its envelope, and when it arrived
    /detections  of a unit: the markers found in an image, and when the unit looked at them
    /heartbeat   when it gave a sign of life, and what it said
    /decide      of a robot: when it decided, its order to the wheels, and whether it was armed
    /sent        of a unit: what it sent on an image
    /view        of a unit: the image as it decided on it, with the goals in it and the shape error
    /stages      of a unit: when an image was taken, came in, was searched and was decided on
    /tell        a line for people
    /image, /overlay, /poses
                 of a unit, now and then: see `skyherd.live.logs.frame_log`
    /end         the process ended as it should

A process that is killed leaves all but the last half second.
"""

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from skyherd.live.lab import Lab
from skyherd.live.logs import frame_log
from skyherd.live.logs.view import View
from skyherd.live.mailbox import Arrival
from skyherd.live.wire import VERSION, envelope_record
from skyherd.messages import Detections
from skyherd.recording.mcap_log import McapLog, Schema
from skyherd.version import __version__

OBJECT: dict[str, Any] = {"type": "object"}

TOPICS: Mapping[str, Schema] = {
    "/about": ("skyherd.About", OBJECT),
    "/end": ("skyherd.End", OBJECT),
    "/heard": ("skyherd.Heard", OBJECT),
    "/detections": ("skyherd.Seen", OBJECT),
    "/heartbeat": ("skyherd.Heartbeat", OBJECT),
    "/decide": ("skyherd.Decided", OBJECT),
    "/sent": ("skyherd.Sent", OBJECT),
    "/view": ("skyherd.View", View),
    "/stages": ("skyherd.Stages", OBJECT),
    "/tell": ("skyherd.StatusLine", OBJECT),
}
"""Topics of a process, and their schemas; the first two are those by which `skyherd.recording.survey` knows
the beginning and the end of a recording."""


def topics_of(name: str) -> dict[str, Schema]:
    """The topics of the file of a process; only units have pictures."""
    return {**TOPICS, **(frame_log.TOPICS if name.startswith("unit/") else {})}


class ProcessLog:
    """Keeps what a process takes in and gives out; a disk that is full ends it with a line, and no more.

    Attributes:
        trouble: why nothing is written any more; None while it is.

    Args:
        path: the file to make.
        name: of the process, such as `robot/3`.
        lab: the set-up.
        now_s: now.

    Raises:
        OSError: the file cannot be made.
    """

    def __init__(self, path: Path, name: str, lab: Lab, now_s: float) -> None:
        self.trouble: str | None = None
        self._path = path
        topics = topics_of(name)
        self._log: McapLog | None = McapLog(path, topics)
        about = {
            "name": name,
            "lab": lab.model.model_dump(mode="json"),
            "version": __version__,
            "format": VERSION,
            "topics": list(topics),
        }
        for _ in range(2):
            self.keep("/about", now_s, about)
            if self._log is not None:
                self._log.flush()

    def heard(self, arrival: Arrival) -> None:
        """Keep a message that arrived."""
        record = envelope_record(arrival.envelope) | {"received_s": arrival.received_s}
        self.keep("/heard", arrival.received_s, record)

    def saw(self, detections: Detections, now_s: float) -> None:
        """Keep what was found in an image, at the moment at which it is decided on."""
        self.keep("/detections", now_s, {"now_s": now_s, "detections": detections})

    def put(self, topic: str, now_s: float, record: Any) -> None:
        """Keep an object of `TOPICS`, with the time as `now_s`."""
        self.keep(topic, now_s, {"now_s": now_s} | record)

    def keep(self, topic: str, now_s: float, record: Any) -> None:
        """Keep a message of one of the topics as it is."""
        if self._log is None:
            return
        try:
            self._log.put(topic, max(0.0, min(now_s, 1e10)), record)
            self._log.flush_when_due(now_s)
        except OSError as error:
            self.trouble = f"{self._path}: {error.strerror or error}; nothing is recorded from now on"
            self._log.abandon()
            self._log = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._log is not None:
            log, self._log = self._log, None
            try:
                log.close()
            except OSError as failed:
                self.trouble = f"{self._path}: {failed.strerror or failed}; its end is missing"
