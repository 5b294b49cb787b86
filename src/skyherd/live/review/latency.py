"""From the capture of an image to the command that follows from it: how long each stage takes."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array
from skyherd.live.review.process_history import GoalNews
from skyherd.live.review.session_history import SessionHistory


@dataclass(frozen=True)
class Stage:
    """A stage of the way from a camera to the wheels.

    Attributes:
        key: in `summary.json`.
        name: a few words.
        meaning: what passes in it.
        times_s: (N,) how long it took, each time that it was measured.
    """

    key: str
    name: str
    meaning: str
    times_s: Array

    @property
    def median_s(self) -> float:
        """Half of the times are shorter; NaN if there are none."""
        return float(np.median(self.times_s)) if self.times_s.size else np.nan

    @property
    def p99_s(self) -> float:
        """One in a hundred of the times is longer; NaN if there are none."""
        return float(np.percentile(self.times_s, 99)) if self.times_s.size else np.nan


def latency_stages(session: SessionHistory) -> list[Stage]:
    """The stages in order, and last the whole way.

    Stages of a unit are measured once an image, those of robots once for each goal that one of them heard.
    Times by two clocks are compared only where the clocks were.
    """
    images = np.array([stages for log in session.logs("unit") for stages in log.stages]).reshape(-1, 5)
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
            "Beyond the fastest picture's way: exposure and coding that all pictures share cannot be seen.",
            between[:, 0],
        ),
        Stage("wait", "arrival → begun", "The unit was busy with an earlier image, or slept.", between[:, 1]),
        Stage("detection", "begun → found", "Markers are found in the image.", between[:, 2]),
        Stage("decision", "found → sent", "Goals are decided on, and all messages sent.", between[:, 3]),
        Stage("radio", "sent → received", "A goal's way to its robot.", received_s - sent_s),
        Stage(
            "command",
            "received → command",
            "Until the robot decides, at once or a fifth of a period after the last time.",
            commanded_s - received_s,
        ),
        Stage("whole", "capture → command", "The whole way.", commanded_s - captured_s),
    ]


def whole_way(session: SessionHistory) -> Iterator[tuple[str, Array, Array]]:
    """For each unit, when commands came that follow from its images, and how old these were then, s."""
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
    """The goals whose sender's clock was known."""
    return (news for news in goals if news.known.is_known)


def _column(values: Iterator[float]) -> Array:
    return np.fromiter(values, dtype=float)
