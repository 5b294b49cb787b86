"""Activity of robots and units over time, as intervals of one reason each."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.live.review.process_history import ProcessHistory
from skyherd.live.review.session_history import SessionHistory
from skyherd.live.robot_core import DRIVING

DECIDING = "decides on images"
"""Activity of a unit while it receives images."""

_NUMBERS = re.compile(r"(?<![/\w])[+-]?\d[\d.]*(e[+-]?\d+)?")
"""Numbers in a reason, except those in process names."""


@dataclass(frozen=True)
class Stretch:
    """A time interval with one activity of a process.

    Attributes:
        reason: `DRIVING`, `DECIDING`, or the reason why the robot stood still, without numbers.
        start_s: start, s since the first record of the run.
        length_s: duration, s.
    """

    reason: str
    start_s: float
    length_s: float


def gist(reason: str) -> str:
    """Return a reason without its numbers, so that reasons that differ only in numbers are equal."""
    return _NUMBERS.sub("…", reason)


def stretches(session: SessionHistory, log: ProcessHistory) -> list[Stretch]:
    """Return the activities of a process in order. A unit has gaps while it receives no images."""
    if log.is_unit:
        times_s = session.times_s(log, [stages.sent_s for stages in log.stages])
        return _runs(times_s, [DECIDING] * times_s.size, session.lab.model.limits.goal_timeout_s)
    times_s = session.times_s(log, [decided.time_s for decided in log.decided])
    return _runs(times_s, [gist(decided.reason) for decided in log.decided], np.inf)


def armed_stretches(session: SessionHistory, log: ProcessHistory) -> list[Stretch]:
    """Return the intervals in which a robot was armed."""
    times_s = session.times_s(log, [decided.time_s for decided in log.decided])
    runs = _runs(times_s, ["armed" if decided.armed else "" for decided in log.decided], np.inf)
    return [run for run in runs if run.reason]


def _runs(times_s: np.ndarray, reasons: Sequence[str], gap_s: float) -> list[Stretch]:
    """Return intervals of equal reasons, each up to the next one, interrupted at gaps above `gap_s`."""
    if not times_s.size:
        return []
    steps_s = np.diff(times_s)
    usual_s = float(np.median(steps_s)) if steps_s.size else 0.0
    found: list[Stretch] = []
    first = 0
    for row in range(1, times_s.size + 1):
        if row < times_s.size and reasons[row] == reasons[first] and steps_s[row - 1] <= gap_s:
            continue
        joined = row < times_s.size and steps_s[row - 1] <= gap_s
        end_s = times_s[row] if joined else times_s[row - 1] + usual_s
        found.append(Stretch(reasons[first], float(times_s[first]), max(0.0, float(end_s - times_s[first]))))
        first = row
    return found


def time_by_reason(session: SessionHistory, logs: Sequence[ProcessHistory]) -> dict[str, float]:
    """Return the total time of each activity, s, the longest first."""
    total_s: dict[str, float] = {}
    for log in logs:
        for stretch in stretches(session, log):
            total_s[stretch.reason] = total_s.get(stretch.reason, 0.0) + stretch.length_s
    return dict(sorted(total_s.items(), key=lambda item: -item[1]))


def driving_share(session: SessionHistory, logs: Sequence[ProcessHistory]) -> float:
    """Return the fraction of recorded time in which robots drove; NaN without decisions."""
    total_s = time_by_reason(session, logs)
    whole_s = sum(total_s.values())
    return total_s.get(DRIVING, 0.0) / whole_s if whole_s else np.nan
