"""Run the tests that are too slow for the gate: slow tests, a tenth of the published missions, random tests.

```sh
python benchmarks/nightly.py                          # all, with seeds of today; hours on two cores
python benchmarks/nightly.py --only trees crowds --share 0.02
python benchmarks/nightly.py --table docs/nightly.md  # the table put there
python benchmarks/nightly.py --only "slow tests of live" --table docs/nightly.md  # that row alone
```

`.ci/nightly` runs it in a fresh environment. Every failed step is named at the end, and the exit code is 1
then. The seeds of missions and random tests follow from the day, so that every night has new ones. `--day`
repeats any night.
"""

import argparse
import datetime
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from skyherd.files.atomic import write_text

ROOT = Path(__file__).parents[1]

Summary = Mapping[str, Any]


@dataclass(frozen=True)
class Missions:
    """A benchmark over random missions.

    Attributes:
        script: in this folder.
        arguments: of its command line.
        published: number of missions of the published figure, of which a share is run.
        is_right: whether its summary is what is published.
        told: of a summary, what the table shows.
    """

    script: str
    arguments: tuple[str, ...]
    published: int
    is_right: Callable[[Summary], bool]
    told: Callable[[Summary], str]


def _all_formed(summary: Summary) -> bool:
    return bool(summary["missions"]) and summary["converged"] == summary["missions"]


def _all_formed_apart(summary: Summary) -> bool:
    return _all_formed(summary) and summary["min_gap_m"] > 0


def _inside_p(summary: Summary) -> bool:
    return _all_formed(summary) and summary["longest_violation_of_those_never_cut_s"] == 0


def _tell_trees(summary: Summary) -> str:
    return (
        f"{summary['converged']} of {summary['missions']} formed, {summary['inside_p_throughout']} inside P "
        f"throughout, radio cut in {summary['missions_cut']}, least gap {summary['min_gap_m']:.3f} m"
    )


MISSIONS: Mapping[str, Missions] = {
    "trees": Missions("topology.py", (), 1000, _inside_p, _tell_trees),
    "rendered": Missions("topology.py", ("--perception", "rendered"), 100, _inside_p, _tell_trees),
    "lossy": Missions("topology.py", ("--network", "lossy"), 200, _inside_p, _tell_trees),
    "killed": Missions("topology.py", ("--kill",), 300, _all_formed, _tell_trees),
    "survivors": Missions("topology.py", ("--survivor",), 100, _all_formed_apart, _tell_trees),
    "chains": Missions(
        "topology.py",
        ("--radio", "1.5", "--form", "chain", "--units", "3", "12"),
        100,
        _inside_p,
        _tell_trees,
    ),
    "stars": Missions(
        "topology.py", ("--radio", "1.5", "--form", "star", "--units", "4", "7"), 100, _inside_p, _tell_trees
    ),
    "radios": Missions("topology.py", ("--radio", "1.5", "--units", "3", "12"), 100, _inside_p, _tell_trees),
    "clocks": Missions("topology.py", ("--clocks", "5"), 200, _inside_p, _tell_trees),
    "crowds": Missions(
        "bodies.py",
        (),
        1000,
        lambda summary: _all_formed(summary) and summary["with_collisions"] == 0,
        lambda summary: (
            f"{summary['converged']} of {summary['missions']} formed, "
            f"{summary['with_collisions']} with collisions"
        ),
    ),
}
"""Missions by name, each with what is published of it."""

SLOW_PARTS = ("vision", "control", "recording", "render", "paper", "sim", "live")
"""Folders of tests whose slow tests are a step each; those of all others are one. *Chosen*: most slow tests
are in them, and what is found in one is told before the next has begun."""

TESTS: Mapping[str, tuple[str, ...]] = {
    **{f"slow tests of {part}": ("-m", "slow and not random", f"tests/{part}") for part in SLOW_PARTS},
    "other slow tests": ("-m", "slow and not random", *(f"--ignore=tests/{part}" for part in SLOW_PARTS)),
    "random tests": ("-m", "random"),
}
"""Arguments of pytest, by name."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of one step: whether it passed, its text, and its time, s."""

    name: str
    is_right: bool
    told: str
    took_s: float

    def row(self, date: datetime.date) -> str:
        """Return the step's row of the table, with the date of the night."""
        verdict, told = "yes" if self.is_right else "**no**", self.told.replace("|", "\\|")
        cells = (self.name, date.isoformat(), verdict, f"{self.took_s / 60:.1f}", told)
        return f"| {' | '.join(cells)} |"


def run_tests(name: str, jobs: int, day: int) -> Outcome:
    """Run one group of tests."""
    command = ["pytest", "-q", "-n", str(jobs), *TESTS[name]]
    began_s = perf_counter()
    ended = subprocess.run(
        [sys.executable, "-m", *command],
        cwd=ROOT,
        env=os.environ | {"SKYHERD_RANDOM_TESTS_SEED": str(day)},
        capture_output=True,
        text=True,
        check=False,
    )
    lines = ended.stdout.splitlines()
    failed = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    print("\n".join(failed), flush=True)
    told = "; ".join([(lines or [ended.stderr])[-1].strip("= "), *failed[:5]])
    return Outcome(name, ended.returncode == 0, told, perf_counter() - began_s)


def run_missions(name: str, share: float, jobs: int, seed: int) -> Outcome:
    """Run a share of one group of missions."""
    missions = MISSIONS[name]
    count = max(1, round(share * missions.published))
    command = [f"benchmarks/{missions.script}", *missions.arguments]
    command += ["--missions", str(count), "--seed", str(seed), "--jobs", str(jobs)]
    began_s = perf_counter()
    ended = subprocess.run(
        [sys.executable, *command], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False
    )
    try:
        summary = json.loads(ended.stdout)
    except json.JSONDecodeError:
        return Outcome(name, False, "no summary", perf_counter() - began_s)
    is_right = ended.returncode == 0 and missions.is_right(summary)
    return Outcome(name, is_right, missions.told(summary), perf_counter() - began_s)


def as_page(outcomes: list[Outcome], date: datetime.date, page_before: str = "") -> str:
    """Return the page with the last outcome of each step, of which some may be of earlier nights.

    Args:
        outcomes: of this night.
        date: of this night, from which its seeds follow.
        page_before: the page as it was; rows of steps that were not run now are taken from it.
    """
    rows = {outcome.name: outcome.row(date) for outcome in outcomes}
    for line in page_before.splitlines():
        name = line.strip("| ").split(" | ")[0]
        if name in {**MISSIONS, **TESTS}:
            rows.setdefault(name, line)
    lines = [
        "# The last nights",
        "",
        "Latest result of each step of `.ci/nightly`. Seeds follow from the date. To repeat a step:",
        '`python benchmarks/nightly.py --only "STEP" --day NIGHT`. Expected: all missions form their shape,',
        "and stay in P without a radio partition or a killed unit.",
        "",
        "| step | night | as expected | minutes | result |",
        "|---|---|---|---|---|",
        *(rows[name] for name in {**MISSIONS, **TESTS} if name in rows),
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the steps, print and write the table; exit code 1 if one is not what it should be."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=[*MISSIONS, *TESTS], metavar="STEP")
    parser.add_argument("--share", type=float, default=0.1, help="of the published number of missions")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--day", type=datetime.date.fromisoformat, default=datetime.date.today())
    parser.add_argument("--table", type=Path)
    options = parser.parse_args()
    chosen = options.only or [*MISSIONS, *TESTS]
    seed = 1000 * options.day.toordinal()
    page_before = options.table.read_text() if options.table and options.table.exists() else ""
    outcomes = []
    for name in chosen:
        if name in TESTS:
            outcomes.append(run_tests(name, options.jobs, options.day.toordinal()))
        else:
            outcomes.append(run_missions(name, options.share, options.jobs, seed))
        print(outcomes[-1].row(options.day), flush=True)
        if options.table:
            write_text(options.table, as_page(outcomes, options.day, page_before))
    wrong = [outcome.name for outcome in outcomes if not outcome.is_right]
    print(f"not as expected: {', '.join(wrong)}" if wrong else "all as expected")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
