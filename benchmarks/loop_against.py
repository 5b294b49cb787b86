"""Comparison of this version of skyherd with another one, in alternation on the same machine.

The other version is a git reference, unpacked into a temporary folder and run by the same interpreter with
the same packages. Each round runs both, each in a process of its own. The order changes from round to round,
so that other load affects both. The result of each quantity is the median ratio over the rounds, with its
minimum and maximum. Processor time (user and system, of all processes) depends less on other load than wall
time, and is reported beside it.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from skyherd.bench.table import short
from skyherd.errors import InputError
from skyherd.jobs.progress import NO_PROGRESS, Progress

LOOP = """
import json, sys
from hashlib import sha256
from time import perf_counter, process_time
wall_s, cpu_s = [perf_counter()], [process_time()]
import cv2
from skyherd.datasets import load_mission
from skyherd.loop import run_steps
cv2.setNumThreads(1)
places = sha256()
for step in run_steps(load_mission(sys.argv[1], ["duration_s=" + sys.argv[2], "perception=rendered"])):
    wall_s.append(perf_counter())
    cpu_s.append(process_time())
    places.update(step.positions_m.tobytes())
print(json.dumps({
    "start: clock, s": wall_s[1] - wall_s[0],
    "start: processor, s": cpu_s[1] - cpu_s[0],
    "step: clock, ms": 1e3 * (wall_s[-1] - wall_s[1]) / (len(wall_s) - 2),
    "step: processor, ms": 1e3 * (cpu_s[-1] - cpu_s[1]) / (len(cpu_s) - 2),
    "places": places.hexdigest(),
}))
"""
"""Code that runs the loop on one core. It prints the time until the first step, the mean time of the
other steps, and a digest of the robots' positions. It uses only functions that all versions have."""

RUN = """
import sys
from skyherd.cli import main
sys.argv[1:] = ["run", sys.argv[1], "--set", "duration_s=" + sys.argv[2], "--out", sys.argv[3], *sys.argv[4:]]
main()
"""
"""Code that calls `skyherd run`."""

Row = dict[str, Any]
"""Quantities of one run of one version, by name."""


@dataclass(frozen=True)
class Ratio:
    """A quantity of two versions, and how they compare.

    Attributes:
        name: of the quantity, with its unit.
        this: median over the rounds, of this version.
        other: the same of the other version.
        ratio: median over the rounds of this over the other.
        least: the least of these ratios.
        greatest: the greatest of them.
    """

    name: str
    this: float
    other: float
    ratio: float
    least: float
    greatest: float

    def cells(self) -> tuple[str, ...]:
        """Return the row of a table: name, this, the other, ratio, and its minimum and maximum."""
        spread = f"{self.least:.2f} to {self.greatest:.2f}"
        return self.name, short(self.this), short(self.other), f"{self.ratio:.2f}", spread


HEADER = ("per", "this", "other", "ratio", "rounds")
"""Names of the columns of `Ratio.cells`."""


def compare(pairs: Sequence[tuple[Row, Row]]) -> list[Ratio]:
    """Return the ratios of each numeric quantity over at least one pair (this, other), a pair a round."""
    return [
        Ratio(
            name,
            statistics.median(this[name] for this, _ in pairs),
            statistics.median(other[name] for _, other in pairs),
            statistics.median(ratios := [this[name] / other[name] for this, other in pairs]),
            min(ratios),
            max(ratios),
        )
        for name, value in pairs[0][0].items()
        if isinstance(value, float)
    ]


def same_places(pairs: Sequence[tuple[Row, Row]]) -> bool:
    """Return whether all runs of both versions have bitwise equal robot positions."""
    return len({row["places"] for pair in pairs for row in pair}) == 1


def measure_pairs(
    name: str,
    duration_s: float,
    other: Path,
    rounds: int,
    *,
    whole: bool = False,
    progress: Progress = NO_PROGRESS,
) -> list[tuple[Row, Row]]:
    """Run this version and another one in alternation.

    Args:
        name: the scenario, which both must have.
        duration_s: simulated time of each run.
        other: the folder from which the other version is imported (`unpacked`).
        rounds: number of pairs.
        whole: also time `skyherd run` with all that it makes, and the same without a video.
        progress: is told how many runs are made.

    Returns:
        what each took, a pair (this, other) a round.

    Raises:
        InputError: the scenario does not run in one of the versions.
    """
    pairs = []
    for number in range(rounds):
        rows = {}
        for count, version in enumerate((None, other) if number % 2 == 0 else (other, None)):
            progress.update(f"{name} against another version", 2 * number + count, 2 * rounds)
            rows[version] = _measure(version, name, duration_s, whole=whole)
        pairs.append((rows[None], rows[other]))
    return pairs


def _measure(version: Path | None, name: str, duration_s: float, *, whole: bool) -> Row:
    """Return the quantities of one run of a version; None is this version."""
    row: Row = json.loads(_call(version, LOOP, [name, str(duration_s)])[0].splitlines()[-1])
    if whole:
        for kind, options in (("run", []), ("run without video", ["--no-video"])):
            with tempfile.TemporaryDirectory() as folder:
                arguments = [name, str(duration_s), str(Path(folder) / "run"), *options]
                _, wall_s, cpu_s = _call(version, RUN, arguments, codes=(0, 1))
            row |= {f"{kind}: clock, s": wall_s, f"{kind}: processor, s": cpu_s}
    return row


def _call(
    version: Path | None, code: str, arguments: list[str], codes: tuple[int, ...] = (0,)
) -> tuple[str, float, float]:
    """Return the output of code in a process with a version, and its wall and processor time, s."""
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    path = {} if version is None else {"PYTHONPATH": str(version)}
    with tempfile.TemporaryDirectory() as folder:
        began_s, before_s = perf_counter(), _processor_s()
        ended = subprocess.run(
            [sys.executable, "-c", code, *arguments],
            capture_output=True,
            text=True,
            cwd=folder,
            env=os.environ | threads | path,
            check=False,
        )
    wall_s, cpu_s = perf_counter() - began_s, _processor_s() - before_s
    if ended.returncode not in codes:
        said = (ended.stderr.strip().splitlines() or [f"ended with code {ended.returncode}"])[-1]
        where = arguments[0] if version is None else f"{arguments[0]} in the other version"
        raise InputError(where, f"does not run: {said}", "a scenario that both versions have")
    return ended.stdout, wall_s, cpu_s


def _processor_s() -> float:
    """Return the processor time of the ended child processes, user and system, s."""
    times = os.times()
    return times.children_user + times.children_system
