"""Content of a live process's recording, as columns for the report."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array, IntArray
from skyherd.live.lab import Lab, make_lab
from skyherd.live.logs.process_log_file import MALFORMED_RECORDS, ProcessLogFile, check_format
from skyherd.live.peers import PeerClocks
from skyherd.live.wire import envelope_of, is_stamp
from skyherd.messages import Detections, MotionGoals
from skyherd.messages.clock_offset import OffsetEstimate
from skyherd.recording.json_codec import from_plain
from skyherd.text import printable, shorten

CLOCK_S = 1.0
"""Sampling period of the other processes' clock offsets, s. Chosen: the drift in it is below 1 ms."""

LONGEST_LINE = 200
"""Length of the longest line shown, characters. Chosen."""


class ClockSample(NamedTuple):
    """Estimate of another process's clock offset, with its time on the estimating process's clock."""

    time_s: float
    known: OffsetEstimate


class Stages(NamedTuple):
    """Times of one image at the stages of a unit, s on the unit's clock."""

    captured_s: float
    arrived_s: float
    begun_s: float
    found_s: float
    sent_s: float


class Seen(NamedTuple):
    """The markers of one image: time of the decision on it, ids (N,), and centres (N, 2), px."""

    time_s: float
    ids: IntArray
    centers_px: Array


class Judged(NamedTuple):
    """Shape error of one image; see `skyherd.live.logs.view.View`."""

    time_s: float
    shape_error: float
    robots: int


class GoalNews(NamedTuple):
    """A goal received by a robot.

    Attributes:
        unit: name of the sending unit.
        captured_s: time of capture of the image, on the unit's clock.
        sent_s: time of sending, on the unit's clock.
        received_s: time of arrival, on the robot's clock.
        commanded_s: time of the robot's next decision, on its clock.
        known: estimated offset of the unit's clock at the arrival.
    """

    unit: str
    captured_s: float
    sent_s: float
    received_s: float
    commanded_s: float
    known: OffsetEstimate


class Decided(NamedTuple):
    """One decision of a robot: time, reason, arm state, wheel command, and age of the newest image."""

    time_s: float
    reason: str
    armed: bool
    v_mps: float
    omega_radps: float
    image_age_s: float


@dataclass
class ProcessHistory:
    """Content of one process's recording.

    Attributes:
        path: the file.
        name: of the process, such as `robot/3`.
        lab: the set-up.
        version: version of skyherd that recorded it.
        flaws: flaws of the file, a short text each.
        ended: whether the process ended in order.
        times_s: times of the first and the last record, on the process's clock.
        lines: status lines with their times.
        clocks: sampled estimates of the other processes' clock offsets, by process.
        refused: numbers of refused messages, by reason.
        refused_at_s: times at which the number of refused messages had increased.
        dropped: number of messages dropped because the queue was full.
        stages: unit: times of its images.
        seen: unit: markers of its images.
        judged: unit: shape errors of its images.
        goals_px: unit: its last goals in the image, by robot.
        image_size_px: unit: width and height of its images; (0, 0) without images.
        lost_pictures: unit: number of camera pictures dropped because the unit was too slow.
        stamped_by: unit: numbers of images stamped by the stream and by their arrival.
        decided: robot: its decisions.
        goals: robot: the goals that it received.
    """

    path: Path
    name: str
    lab: Lab
    version: str
    flaws: list[str] = field(default_factory=list)
    ended: bool = False
    times_s: tuple[float, float] = (np.inf, -np.inf)
    lines: list[tuple[float, str]] = field(default_factory=list)
    clocks: dict[str, list[ClockSample]] = field(default_factory=dict)
    refused: dict[str, int] = field(default_factory=dict)
    refused_at_s: list[float] = field(default_factory=list)
    dropped: int = 0
    stages: list[Stages] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    judged: list[Judged] = field(default_factory=list)
    goals_px: dict[int, tuple[float, float]] = field(default_factory=dict)
    image_size_px: tuple[int, int] = (0, 0)
    lost_pictures: int = 0
    stamped_by: Counter[str] = field(default_factory=Counter)
    decided: list[Decided] = field(default_factory=list)
    goals: list[GoalNews] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._peers = PeerClocks(self.name, self.lab.clock_limits)
        self._waiting: list[GoalNews] = []
        self._looked_s = -np.inf

    @property
    def number(self) -> int:
        """Number of the unit, or marker id of the robot."""
        return int(self.name.partition("/")[2])

    @property
    def is_unit(self) -> bool:
        """True for a unit, False for a robot."""
        return self.name.startswith("unit/")

    def take(self, topic: str, record: dict[str, Any]) -> None:
        """Process a record.

        Raises:
            MALFORMED_RECORDS: the record does not have this version's format.
        """
        reader = getattr(self, f"_take_{topic.removeprefix('/')}", None)
        if reader is not None:
            reader(record)

    def _now_s(self, record: dict[str, Any], key: str = "now_s") -> float:
        now_s = _stamp(record[key])
        self.times_s = min(self.times_s[0], now_s), max(self.times_s[1], now_s)
        return now_s

    def _take_heard(self, record: dict[str, Any]) -> None:
        received_s, sent_s = self._now_s(record, "received_s"), _stamp(record["sent_s"])
        envelope = envelope_of(record)
        message = envelope.message
        self._peers.hear(envelope, received_s)
        if isinstance(message, MotionGoals) and self.number in message.ids and not self.is_unit:
            known = self._peers.estimate(envelope.sender, received_s)
            news = GoalNews(envelope.sender, message.time_s, sent_s, received_s, np.nan, known)
            self._waiting.append(news)

    def _take_heartbeat(self, record: dict[str, Any]) -> None:
        now_s = self._now_s(record)
        refused = {_line(why): int(count) for why, count in record["refused"].items()}
        if sum(refused.values()) > sum(self.refused.values()):
            self.refused_at_s.append(now_s)
        self.refused = refused
        self.dropped = int(record["dropped"])
        heard = self._peers.heard(now_s)
        if not 0 <= now_s - self._looked_s < CLOCK_S:
            self._looked_s = now_s
            for name in heard:
                self.clocks.setdefault(name, []).append(ClockSample(now_s, self._peers.estimate(name, now_s)))

    def _take_decide(self, record: dict[str, Any]) -> None:
        now_s, order, age_s = self._now_s(record), record["order"], record["image_age_s"]
        decided = Decided(
            now_s,
            _line(order["reason"]),
            bool(record["armed"]),
            _finite(order["v_mps"]),
            _finite(order["omega_radps"]),
            np.nan if age_s is None else _finite(age_s),
        )
        self.decided.append(decided)
        self.goals += [news._replace(commanded_s=now_s) for news in self._waiting]
        self._waiting = []

    def _take_detections(self, record: dict[str, Any]) -> None:
        found = from_plain(Detections, record["detections"])
        size = found.image_size_px
        if not ((size > 0) & (size < 1e6)).all():
            raise ValueError("image_size_px")
        self.image_size_px = int(size[0]), int(size[1])
        once = found.unambiguous()
        self.seen.append(Seen(self._now_s(record), once.ids, once.centers_px))

    def _take_view(self, record: dict[str, Any]) -> None:
        error = record["shape_error"]
        judged = Judged(
            self.seen[-1].time_s, np.nan if error is None else _finite(error), int(record["robots"])
        )
        self.judged.append(judged)
        places = zip(record["ids"], record["goals_px"], strict=True)
        self.goals_px = {int(robot): (_finite(u), _finite(v)) for robot, (u, v) in places}

    def _take_stages(self, record: dict[str, Any]) -> None:
        self._now_s(record)
        self.stages.append(Stages(*(_stamp(record[name]) for name in Stages._fields)))
        self.stamped_by[_line(record["stamped_by"])] += 1
        self.lost_pictures = int(record["dropped"])

    def _take_tell(self, record: dict[str, Any]) -> None:
        self.lines.append((self._now_s(record), _line(record["line"])))


def read_history(path: Path) -> ProcessHistory:
    """Read the recording of a live process, as far as possible. Its `flaws` describe damages.

    Raises:
        InputError: the file does not exist, or has no readable record of a live process.
    """
    process_log = ProcessLogFile(path)
    log: ProcessHistory | None = None
    flaws = [str(flaw) for flaw in process_log.flaws]
    try:
        with np.errstate(invalid="raise", over="raise"):
            for entry in process_log.entries():
                if log is not None:
                    log.take(entry.topic, entry.content)
                elif entry.topic == "/about":
                    log = _begin(path, entry.content)
    except MALFORMED_RECORDS as error:
        why = shorten(" ".join(printable(str(error)).split()), 80)
        flaws.append(f"its records do not have this version's format ({why})")
    if log is None:
        why = "; ".join(flaws) or "no record with the process name"
        raise InputError(str(path), why, "a file of `skyherd live run` of this version")
    log.flaws, log.ended = flaws, process_log.ended
    return log


def _begin(path: Path, about: dict[str, Any]) -> ProcessHistory:
    """Return the empty history of a process, from the first record of its recording."""
    check_format(about, path)
    lab, name = make_lab(about["lab"], where=str(path)), str(about["name"])
    kind, _, number = name.partition("/")
    known = {"unit": range(len(lab.model.cameras)), "robot": lab.ids}
    if int(number) not in known[kind] or name != f"{kind}/{int(number)}":
        raise ValueError("name")
    return ProcessHistory(path, name, lab, _line(about["version"]))


def _stamp(value: Any) -> float:
    if not is_stamp(value):
        raise ValueError("not a time")
    return float(value)


def _finite(value: Any) -> float:
    number = float(value)
    if not abs(number) < 1e9:
        raise ValueError("not a finite number")
    return number


def _line(text: Any) -> str:
    return shorten(printable(str(text)), LONGEST_LINE)
