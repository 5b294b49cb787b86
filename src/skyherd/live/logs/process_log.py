"""Recording of one process: its inputs and outputs, in an MCAP file.

The file has all inputs in their order, so that `skyherd.live.logs.replay` reproduces the decisions:

    /about       twice at the beginning: process name, validated lab, versions and topics
    /heard       a received message: envelope and time of arrival
    /detections  unit: detected markers of an image, and the time of the decision on them
    /heartbeat   time of a heartbeat, and counts of refused and dropped messages
    /decide      robot: a decision with its time, trouble of the link, wheel command and arm state
    /sent        unit: the messages sent after an image
    /view        unit: goals and shape error of an image
    /stages      unit: times of capture, arrival, detection and decision of an image
    /tell        a status line for people
    /image, /overlay, /poses, /marker_poses
                 unit: previews at a low rate, see `skyherd.live.logs.frame_log`
    /end         orderly end of the process

The recording of a killed process lacks at most the last half second.
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
"""Topics of a process, and their schemas. The first two mark the beginning and the end of a recording for
`skyherd.recording.survey`."""


def topics_of(name: str) -> dict[str, Schema]:
    """Return the topics in the file of a process. Only units have previews."""
    return {**TOPICS, **(frame_log.TOPICS if name.startswith("unit/") else {})}


class ProcessLog:
    """Writer of a process's recording. A write error ends the recording, but not the process.

    Attributes:
        trouble: the write error that ended the recording, or None.

    Args:
        path: the new file.
        name: of the process, such as `robot/3`.
        lab: the set-up.
        now_s: current time.
        supervised: whether a session runs the process.
        dry_run: whether its commands are not sent.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(
        self,
        path: Path,
        name: str,
        lab: Lab,
        now_s: float,
        *,
        supervised: bool = False,
        dry_run: bool = False,
    ) -> None:
        self.trouble: str | None = None
        self._path = path
        topics = topics_of(name)
        self._log: McapLog | None = McapLog(path, topics)
        about = {
            "name": name,
            "lab": lab.model.model_dump(mode="json"),
            "supervised": supervised,
            "dry_run": dry_run,
            "version": __version__,
            "format": VERSION,
            "topics": list(topics),
        }
        for _ in range(2):
            self.keep("/about", now_s, about)
            if self._log is not None:
                self._log.flush()

    def heard(self, arrival: Arrival) -> None:
        """Record a received message."""
        record = envelope_record(arrival.envelope) | {"received_s": arrival.received_s}
        self.keep("/heard", arrival.received_s, record)

    def saw(self, detections: Detections, now_s: float) -> None:
        """Record the detections in an image, at the time of the decision on them."""
        self.keep("/detections", now_s, {"now_s": now_s, "detections": detections})

    def put(self, topic: str, now_s: float, record: Any) -> None:
        """Record an object under one of `TOPICS`, with the time as `now_s`."""
        self.keep(topic, now_s, {"now_s": now_s} | record)

    def keep(self, topic: str, now_s: float, record: Any) -> None:
        """Record an object under one of the topics unchanged."""
        if self._log is None:
            return
        try:
            self._log.put(topic, max(0.0, min(now_s, 1e10)), record)
            self._log.flush_when_due(now_s)
        except OSError as error:
            self.trouble = f"{self._path}: {error.strerror or error}; recording has ended"
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
                self.trouble = (
                    f"{self._path}: {failed.strerror or failed}; the end of the recording is missing"
                )
