"""Latency from the capture of an image to the resulting command, by stage."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array
from skyherd.live.review.process_history import GoalNews
from skyherd.live.review.session_history import SessionHistory


@dataclass(frozen=True)
class Stage:
    """A stage of the latency from camera to wheels.

    Attributes:
        key: its key in `summary.json`.
        name: short name.
        meaning: explanation for people.
        times_s: (N,) measured durations.
    """

    key: str
    name: str
    meaning: str
    times_s: Array

    @property
    def median_s(self) -> float:
        """Median duration, s; NaN without measurements."""
        return float(np.median(self.times_s)) if self.times_s.size else np.nan

    @property
    def p99_s(self) -> float:
        """99th percentile of the duration, s; NaN without measurements."""
        return float(np.percentile(self.times_s, 99)) if self.times_s.size else np.nan


def latency_stages(session: SessionHistory) -> list[Stage]:
    """Return the stages in order, and the total latency last.

    Stages of a unit are measured once per image, and stages of robots once per received goal. Images that
    gave no robot a goal, as those after a stop, count only if there are no others: the total latency has none
    of them. Times on two clocks are compared only if the offset of the clocks is known.
    """
    images = np.array([stages for log in session.logs("unit") for stages in log.stages]).reshape(-1, 5)
    aimed_s = [news.captured_s for log in session.logs("robot") for news in log.goals]
    has_goals = np.isin(images[:, 0], aimed_s)
    images = images[has_goals] if has_goals.any() else images
    between = np.diff(images, axis=1)
    goals = [(news, news.known.offset_s) for log in session.logs("robot") for news in _compared(log.goals)]
    sent_s = _column(news.sent_s - offset_s for news, offset_s in goals)
    captured_s = _column(news.captured_s - offset_s for news, offset_s in goals)
    received_s = _column(news.received_s for news, _ in goals)
    commanded_s = _column(news.commanded_s for news, _ in goals)
    return [
        Stage(
            "arrival",
            "capture → arrival",
            "Relative to the fastest picture: constant latency of exposure and encoding is not measurable.",
            between[:, 0],
        ),
        Stage(
            "wait", "arrival → begun", "The unit processed an earlier image, or was suspended.", between[:, 1]
        ),
        Stage("detection", "begun → found", "Detection of the markers in the image.", between[:, 2]),
        Stage(
            "decision", "found → sent", "Decision on the goals, and sending of all messages.", between[:, 3]
        ),
        Stage("radio", "sent → received", "Transmission of a goal to its robot.", received_s - sent_s),
        Stage(
            "command",
            "received → command",
            "Until the robot decides: at once, or a fifth of a period after its last decision.",
            commanded_s - received_s,
        ),
        Stage("whole", "capture → command", "Total latency.", commanded_s - captured_s),
    ]


def whole_way(session: SessionHistory) -> Iterator[tuple[str, Array, Array]]:
    """Yield, for each unit, the times of commands from its images, and the images' ages then, s."""
    for name in session.runs:
        times, ages = [], []
        for log in session.logs("robot"):
            goals = [news for news in _compared(log.goals) if news.unit == name]
            commanded_s = _column(news.commanded_s for news in goals)
            times.append(session.times_s(log, commanded_s))
            ages.append(commanded_s - _column(news.captured_s - news.known.offset_s for news in goals))
        if sum(one.size for one in ages):
            yield name, np.concatenate(times), np.concatenate(ages)


def _compared(goals: list[GoalNews]) -> Iterator[GoalNews]:
    """Return the goals whose sender's clock offset was known."""
    return (news for news in goals if news.known.is_known)


def _column(values: Iterator[float]) -> Array:
    return np.fromiter(values, dtype=float)
