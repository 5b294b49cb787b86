"""The files of a live run, joined: every process on one time axis, and what is missing."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array
from skyherd.jobs.progress import NO_PROGRESS, Progress
from skyherd.live.lab import Lab
from skyherd.live.review.process_history import ProcessHistory, read_history
from skyherd.messages.clock_offset import OffsetEstimate

ALLOWED = "a folder of `skyherd live run`"
"""What is to be given where something else was, as complaints say it."""

SHOWN_FLAWS = 4
"""Flaws of a run that its one line names; the others are counted. Chosen: what fits into two lines."""


def recorded_files(folder: Path) -> list[Path]:
    """The files of the processes of a live run, those of units first; none if it is no such folder."""
    if not folder.is_dir():
        return []
    return sorted(folder.glob("unit_*.mcap")) + sorted(folder.glob("robot_*.mcap"))


@dataclass(frozen=True)
class SessionHistory:
    """A live run as its files have it.

    Times of a process are by its own clock; `times_s` lays them against that of one unit or robot, the
    reference, as well as the two clocks were compared, and counts them from the first record of all.

    Attributes:
        lab: the set-up.
        runs: the files of each process by its name, units first, each time that it ran in order.
        flaws: what is wrong with files, or missing, a line for each file.
        reference: name of the process whose clock the times are on.
        zero_s: first record of all, by that clock.
        end_s: last record of all, s since the first.
    """

    lab: Lab
    runs: dict[str, list[ProcessHistory]]
    flaws: list[str]
    reference: str
    zero_s: float
    end_s: float

    def times_s(self, log: ProcessHistory, times_s: Sequence[float] | Array) -> Array:
        """Times (N,) by the clock of a process, in seconds since the beginning of the run."""
        shift_s = clock_of(log, self.reference).offset_s
        return np.asarray(times_s, dtype=float) + shift_s - self.zero_s

    def logs(self, kind: str) -> Iterator[ProcessHistory]:
        """All files of `unit` or `robot`, in order."""
        for name, logs in self.runs.items():
            if name.startswith(f"{kind}/"):
                yield from logs

    def first_units(self) -> Iterator[ProcessHistory]:
        """The first file of each unit."""
        return (logs[0] for logs in self.runs.values() if logs[0].is_unit)

    @property
    def restarts(self) -> int:
        """How often a process was started again."""
        return sum(len(logs) - 1 for logs in self.runs.values())

    @property
    def refused(self) -> int:
        """How many messages were refused, by all processes together."""
        return sum(sum(log.refused.values()) for logs in self.runs.values() for log in logs)

    @property
    def flaw_line(self) -> str:
        """What is wrong with the recording, in one line; empty if nothing is."""
        more = len(self.flaws) - SHOWN_FLAWS
        return "; ".join(self.flaws[:SHOWN_FLAWS]) + (f"; and {more} more" if more > 0 else "")


def clock_of(log: ProcessHistory, name: str) -> OffsetEstimate:
    """What a process knew of another one's clock, all in all: the median, and its uncertainty in the median.

    Nothing is known of a process that it never compared clocks with; its own clock is its own.
    """
    if name == log.name:
        return OffsetEstimate(0.0, 0.0)
    known = [sample.known for sample in log.clocks.get(name, []) if sample.known.is_known]
    if not known:
        return OffsetEstimate(0.0, float("inf"))
    return OffsetEstimate(
        float(np.median([one.offset_s for one in known])),
        float(np.median([one.uncertainty_s for one in known])),
    )


def read_session(folder: Path, progress: Progress = NO_PROGRESS) -> SessionHistory:
    """Read all files of a live run, as far as they can be read.

    Raises:
        InputError: there are none, or nothing can be read of any of them.
    """
    paths = recorded_files(folder)
    if not paths:
        raise InputError(str(folder), "no recordings of units or robots", ALLOWED)
    logs: list[ProcessHistory] = []
    flaws: list[str] = []
    for number, path in enumerate(paths):
        progress.update(folder.name, number, len(paths), path.name)
        try:
            log = read_history(path)
        except InputError as error:
            flaws.append(f"{path.name}: {error.what}")
            continue
        if logs and log.lab.model != logs[0].lab.model:
            flaws.append(f"{path.name}: of another lab, left out")
        elif not np.isfinite(log.times_s).all():
            flaws.append(f"{path.name}: nothing was recorded yet")
        else:
            flaws += [f"{path.name}: {', '.join(log.flaws)}"] * bool(log.flaws)
            logs.append(log)
    if not logs:
        raise InputError(
            str(folder), f"nothing of it can be read ({'; '.join(flaws[:SHOWN_FLAWS])})", ALLOWED
        )
    return _joined(logs, flaws)


def _joined(logs: list[ProcessHistory], flaws: list[str]) -> SessionHistory:
    lab = logs[0].lab
    names = [f"unit/{unit}" for unit in range(len(lab.model.cameras))] + [f"robot/{r}" for r in lab.ids]
    runs = {
        name: sorted((log for log in logs if log.name == name), key=lambda log: log.times_s[0])
        for name in names
    }
    missing = [name for name, found in runs.items() if not found]
    runs = {name: found for name, found in runs.items() if found}
    if missing:
        flaws = [*flaws, f"no recording of {', '.join(missing)}"]
    reference = next(iter(runs))
    spans = [
        (log.times_s[0] + offset_s, log.times_s[1] + offset_s)
        for log in logs
        for offset_s in [clock_of(log, reference).offset_s]
    ]
    zero_s = min(first for first, _ in spans)
    return SessionHistory(lab, runs, flaws, reference, zero_s, max(last for _, last in spans) - zero_s)
