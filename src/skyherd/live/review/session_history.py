"""Joined recordings of a live run: all processes on one time axis, and missing files."""

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
"""Expected input, for error messages."""

SHOWN_FLAWS = 4
"""Largest number of flaws named in a line; further ones are counted. Chosen: they fit into two lines."""


def recorded_files(folder: Path) -> list[Path]:
    """Return the recordings of a live run, units first, or an empty list for another folder."""
    if not folder.is_dir():
        return []
    return sorted(folder.glob("unit_*.mcap")) + sorted(folder.glob("robot_*.mcap"))


@dataclass(frozen=True)
class SessionHistory:
    """The joined recordings of a live run.

    Recorded times are on the clock of each process. `times_s` converts them to the clock of a reference
    process, by the estimated offset, and counts them from the first record of the run.

    Attributes:
        lab: the set-up.
        runs: recordings of each process by its name, units first, in the order of its starts.
        flaws: damages and missing files, one line per file.
        reference: name of the reference process.
        zero_s: time of the first record of the run, on the reference clock.
        end_s: time of the last record, s since the first one.
    """

    lab: Lab
    runs: dict[str, list[ProcessHistory]]
    flaws: list[str]
    reference: str
    zero_s: float
    end_s: float

    def times_s(self, log: ProcessHistory, times_s: Sequence[float] | Array) -> Array:
        """Return times (N,) on the clock of a process as seconds since the first record of the run."""
        shift_s = clock_of(log, self.reference).offset_s
        return np.asarray(times_s, dtype=float) + shift_s - self.zero_s

    def logs(self, kind: str) -> Iterator[ProcessHistory]:
        """Yield the recordings of all processes of the kind `unit` or `robot`, in order."""
        for name, logs in self.runs.items():
            if name.startswith(f"{kind}/"):
                yield from logs

    def first_units(self) -> Iterator[ProcessHistory]:
        """Yield the first recording of each unit."""
        return (logs[0] for logs in self.runs.values() if logs[0].is_unit)

    @property
    def restarts(self) -> int:
        """Number of restarts of all processes."""
        return sum(len(logs) - 1 for logs in self.runs.values())

    @property
    def refused(self) -> int:
        """Number of messages refused by all processes."""
        return sum(sum(log.refused.values()) for logs in self.runs.values() for log in logs)

    @property
    def flaw_line(self) -> str:
        """Flaws of the recording in one line; empty without flaws."""
        more = len(self.flaws) - SHOWN_FLAWS
        return "; ".join(self.flaws[:SHOWN_FLAWS]) + (f"; and {more} more" if more > 0 else "")


def clock_of(log: ProcessHistory, name: str) -> OffsetEstimate:
    """Return a process's estimate of another one's clock offset: medians of offset and uncertainty.

    The uncertainty is infinite for a process whose clock was never compared. The offset to itself is 0.
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
    """Read all recordings of a live run, as far as possible.

    Raises:
        InputError: the folder has no readable recording.
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
            flaws.append(f"{path.name}: no records yet")
        else:
            flaws += [f"{path.name}: {', '.join(log.flaws)}"] * bool(log.flaws)
            logs.append(log)
    if not logs:
        raise InputError(str(folder), f"no readable recording ({'; '.join(flaws[:SHOWN_FLAWS])})", ALLOWED)
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
