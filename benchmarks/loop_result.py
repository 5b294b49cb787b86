"""The result of `benchmarks/loop.py`: measured, as JSON, and as tables."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from loop_against import HEADER, Ratio, compare, measure_pairs, same_places
from loop_parts import PARTS, measure_parts
from versions import unpacked

from skyherd.bench.result import environment
from skyherd.bench.table import Table, short
from skyherd.datasets import load_mission
from skyherd.files.atomic import write_text
from skyherd.jobs.progress import NO_PROGRESS, Progress

RESULT = "loop.json"
"""Name of the file with the result."""


@dataclass(frozen=True)
class Comparison:
    """A scenario in this version and another one.

    Attributes:
        scenario: its name.
        same_places: whether the robots were at the same places, to the last bit, in both.
        ratios: of each quantity.
        rounds: what each run took, (this, other) in each round.
    """

    scenario: str
    same_places: bool
    ratios: list[Ratio]
    rounds: list[tuple[dict[str, Any], dict[str, Any]]]


@dataclass(frozen=True)
class LoopResult:
    """Result of the measurement.

    Attributes:
        environment: versions, machine, and what was asked for.
        scenarios: the figures of `loop_parts.measure_parts`, a dictionary a scenario.
        against: the other version; None if there was none.
        comparisons: with it, one a scenario.
    """

    environment: dict[str, Any]
    scenarios: list[dict[str, Any]]
    against: str | None
    comparisons: list[Comparison]

    def write(self, folder: Path) -> Path:
        """Write `loop.json` into a folder and return its path; OutputError if it cannot be written."""
        return write_text(folder / RESULT, json.dumps(asdict(self), indent=1) + "\n")


def measure_loop(
    names: Sequence[str],
    duration_s: float,
    *,
    against: str | None = None,
    repository: Path,
    rounds: int = 3,
    whole: bool = False,
    progress: Progress = NO_PROGRESS,
) -> LoopResult:
    """Measure scenarios, one after the other, and against another version if one is given.

    Args:
        names: of built-in scenarios, or TOML files.
        duration_s: simulated time of each run.
        against: the other version, a reference of git.
        repository: folder of the git repository that has it.
        rounds: runs of each version.
        whole: also compare `skyherd run` with all that it makes.
        progress: is told what is being measured.

    Raises:
        InputError: there is no such scenario or version, or one does not run in the other.
    """
    for name in names:
        load_mission(name)
    comparisons = []
    if against is not None:
        with unpacked(against, repository) as other:
            for name in names:
                place = str(Path(name).absolute()) if Path(name).is_file() else name
                pairs = measure_pairs(place, duration_s, other, rounds, whole=whole, progress=progress)
                comparisons.append(Comparison(name, same_places(pairs), compare(pairs), pairs))
    scenarios = []
    for number, name in enumerate(names):
        progress.update(f"parts of {name}", number, len(names))
        scenarios.append(measure_parts(name, duration_s))
    return LoopResult(environment(duration_s=duration_s), scenarios, against, comparisons)


def tables(result: LoopResult) -> list[Table]:
    """Return the result as tables: the shares of time, and each comparison."""
    parts = [
        (
            row["scenario"],
            short(row["steps_per_s"]),
            short(row["step_ms_median"]),
            *(f"{row['share'][part]:.0%}" for part in (*PARTS, "rest")),
        )
        for row in result.scenarios
    ]
    detectors = [
        (
            row["scenario"],
            short(row["frame_ms_median"]["detect"]),
            short(row["plain_aruco_ms_median"]),
            short(row["ratio_to_plain_aruco"]),
        )
        for row in result.scenarios
    ]
    return [
        Table(
            "The loop on one core",
            "Median of a step, and shares of all steps' time.",
            ("scenario", "steps/s", "step, ms", *PARTS, "rest"),
            tuple(parts),
        ),
        Table(
            "Detection in one image",
            "Medians. OpenCV's detector has its defaults; the ratio is its time over ours.",
            ("scenario", "ours, ms", "OpenCV, ms", "ratio"),
            tuple(detectors),
        ),
        *(_compared(one, result.against) for one in result.comparisons),
    ]


def _compared(one: Comparison, against: str | None) -> Table:
    """Return a comparison as a table."""
    where = "the same places, to the last bit." if one.same_places else "other places."
    return Table(
        f"{one.scenario} against {against}",
        f"Medians of the rounds. Robots were at {where}",
        HEADER,
        tuple(ratio.cells() for ratio in one.ratios),
    )
