"""Reading of a live run for an export."""

import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from skyherd.jobs.progress import NO_PROGRESS, Progress
from skyherd.live.logs.process_log_file import MALFORMED_RECORDS, ProcessLogFile
from skyherd.live.review.process_history import ProcessHistory
from skyherd.live.review.session_history import SessionHistory, clock_of, read_session
from skyherd.live.wire import Message, is_stamp, plain_message
from skyherd.messages import Detections, MotionGoals, Proximity, UnitReport
from skyherd.recording.export import Commanded, Moment, RecordedRun, Seen
from skyherd.recording.json_codec import from_plain
from skyherd.text import printable, shorten

KIND_BY_KEY = {"rho_px": "goals", "horizon_sides": "proximity", "controlled_ids": "report"}
"""Kinds of sent messages by a key that no other kind has. Recordings store sent messages without their
kind."""

MAX_STATE = 200
"""Maximum length of a robot's state, characters. Chosen: as in the report of a live run."""


def read_live_run(folder: Path, progress: Progress = NO_PROGRESS) -> RecordedRun:
    """Read the recordings of all processes of a live run.

    Preview images are not part of it: they are smaller than the images in which markers were found.

    Args:
        folder: a folder of `skyherd live run`.
        progress: receives the number of files read.

    Raises:
        InputError: the folder has no readable recording.
    """
    session = read_session(folder, progress)
    flaws = list(session.flaws)
    versions = {log.version for logs in session.runs.values() for log in logs}
    return RecordedRun(
        name=folder.resolve().name,
        kind="live",
        ids=np.array(session.lab.ids, dtype=np.int64),
        units=len(session.lab.model.cameras),
        side_m=session.lab.model.markers.side_m,
        start_unix_s=session.zero_s,
        end_s=session.end_s,
        configuration=session.lab.model.model_dump(mode="json", exclude_none=True),
        versions={"skyherd": ", ".join(sorted(versions))},
        moments=lambda: _moments(session, flaws),
        flaws=flaws,
    )


def _moments(session: SessionHistory, flaws: list[str]) -> Iterator[Moment]:
    """Yield the records of all processes in the order of decisions; add unreadable parts to `flaws`."""
    files = [_of_process(session, log, flaws) for logs in session.runs.values() for log in logs]
    for _, moment in heapq.merge(*files, key=lambda timed: timed[0]):
        yield moment


def _of_process(
    session: SessionHistory, log: ProcessHistory, flaws: list[str]
) -> Iterator[tuple[float, Moment]]:
    """Yield the records of one process with the times of the decisions, up to the first malformed one."""
    shift_s = clock_of(log, session.reference).offset_s - session.zero_s
    pending: tuple[float, Detections] | None = None
    try:
        for entry in ProcessLogFile(log.path).entries():
            record = entry.content
            if entry.topic == "/detections":
                if pending is not None:
                    yield _seen(pending, [], shift_s)
                found = from_plain(Detections, record["detections"])
                pending = _stamp(record["now_s"]) + shift_s, found
            elif entry.topic == "/sent" and pending is not None:
                yield _seen(pending, _messages(record["messages"]), shift_s)
                pending = None
            elif entry.topic == "/decide":
                commanded = _commanded(log.number, record, shift_s)
                yield commanded.time_s, commanded
    except MALFORMED_RECORDS as error:
        why = shorten(" ".join(printable(str(error)).split()), 80)
        flaw = f"{log.path.name}: its records do not have this version's format ({why})"
        if not any(known.startswith(f"{log.path.name}: ") for known in flaws):
            flaws.append(flaw)
    if pending is not None:
        yield _seen(pending, [], shift_s)


def _messages(records: list[dict[str, Any]] | None) -> list[Message]:
    """Return the goals, the bodies and the report among the messages that a unit sent."""
    kinds = [(record, KIND_BY_KEY.keys() & record.keys()) for record in records or []]
    return [plain_message(KIND_BY_KEY[keys.pop()], record) for record, keys in kinds if keys]


def _seen(pending: tuple[float, Detections], messages: list[Message], shift_s: float) -> tuple[float, Moment]:
    decided_s, found = pending
    seen = Seen(
        time_s=found.time_s + shift_s,
        decided_s=decided_s,
        detections=found,
        goals=next((one for one in messages if isinstance(one, MotionGoals)), None),
        proximity=next((one for one in messages if isinstance(one, Proximity)), None),
        report=next((one for one in messages if isinstance(one, UnitReport)), None),
    )
    return decided_s, seen


def _commanded(robot: int, record: dict[str, Any], shift_s: float) -> Commanded:
    order, age_s = record["order"], record["image_age_s"]
    return Commanded(
        time_s=_stamp(record["now_s"]) + shift_s,
        ids=np.array([robot], dtype=np.int64),
        v_mps=np.array([float(order["v_mps"])]),
        omega_radps=np.array([float(order["omega_radps"])]),
        states=(shorten(printable(str(order["reason"])), MAX_STATE),),
        armed=bool(record["armed"]),
        image_age_s=None if age_s is None else float(age_s),
    )


def _stamp(value: Any) -> float:
    if not is_stamp(value):
        raise ValueError("not a time")
    return float(value)
