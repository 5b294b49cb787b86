"""Print the two tables of docs/methods.md, and the seeds of the starts in which skyherd failed.

python docs/scripts/methods_tables.py DIR            # DIR is that of `skyherd study methods --out DIR`
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from skyherd.study.methods.outcomes import Method, Outcomes, make_methods
from skyherd.study.methods.plots import median
from skyherd.study.spec import load_study
from skyherd.study.table import read_table

OURS = "skyherd"
AFFINE = ("affine, modules", "affine, stress")
"""Methods that promise an affine image of the shape and no more."""

SIDE_M, BODY_M, MARGIN_M = 0.4, 0.4, 0.08
"""Side of a marker, radius of a robot's body and margin of the avoidance, m, in every task of the study."""

MOVED_M = 0.005
"""A robot that stayed within this of where it began did not move. Chosen: a hundredth of its body."""


def formed(method: Method, runs: Outcomes) -> str:
    """How many starts formed the shape, and the median time of these from the start, as `49, 40.2`.

    An affine law's has in brackets how many formed an affine image, and the time is that of the image.
    """
    own, image = int(runs.converged.sum()), int(runs.affine.sum())
    promised = method.name in AFFINE
    time_s = median(runs.begun_s + (runs.affine_times_s if promised else runs.times_s))
    count = f"{own} ({image})" if promised else f"{own}"
    return f"{count}, {time_s:.3g}" if (image if promised else own) else count


def way(runs: Outcomes) -> str:
    """The median way over the shortest, and in how many starts bodies collided, as `2.7 (0)`."""
    return f"{median(runs.detours):.2g} ({int(runs.collided.sum())})"


def numbers(method: Method) -> str:
    """The least and the largest of the tasks' median numbers a robot and second, as `336 to 624`."""
    each = [median(runs.numbers_ps) for runs in method.outcomes.values()]
    return f"{min(each):.0f} to {max(each):.0f}"


def print_table(head: list[str], rows: list[list[str]]) -> None:
    """Print a Markdown table whose first column has no title."""
    for line in ["", *head], ["---"] * (len(head) + 1), *rows:
        print(f"| {' | '.join(line)} |")
    print()


def start_gap_m(row: dict[str, Any]) -> float:
    """The least gap between two bodies at the start of a run, obstacles' too."""
    places_m = np.array(row["history.waypoints_m"][0])
    obstacles = row["obstacles"] or []
    others_m = np.array([*places_m, *(one["position_m"] for one in obstacles)])
    radii_m = np.array([*[BODY_M] * len(places_m), *(SIDE_M * one["radius_sides"] for one in obstacles)])
    gaps_m = np.linalg.norm(others_m - places_m[:, None], axis=-1) - BODY_M - radii_m
    np.fill_diagonal(gaps_m, np.inf)
    return float(gaps_m.min())


def still(row: dict[str, Any]) -> list[int]:
    """Robots that did not move."""
    ways_m = np.array(row["history.waypoints_m"])
    farthest_m = np.linalg.norm(ways_m - ways_m[0], axis=-1).max(axis=0)
    return [int(robot) for robot in np.flatnonzero(farthest_m < MOVED_M)]


def print_failures(rows: list[dict[str, Any]]) -> None:
    """Print what became of the runs in which something failed, and how many began inside the margin."""
    for row in rows:
        if row["collisions"] or not row["converged"]:
            print(
                f"{row['task']}, seed {row['seed']}: {'' if row['converged'] else 'not '}formed,"
                f" {row['collisions']} collisions, {100 * row['shape_error']:.2g} % off at the end,"
                f" least gap at the start {start_gap_m(row):.3f} m, robots that did not move: {still(row)}"
            )
    near = np.array([start_gap_m(row) < MARGIN_M for row in rows])
    done = np.array([row["converged"] for row in rows])
    for where, runs in (("inside", done[near]), ("outside", done[~near])):
        print(f"starts {where} the margin: {runs.sum()} of {runs.size} formed")


def main(folder: Path) -> None:
    """Print everything that docs/methods.md quotes and that the study's own tables do not have."""
    study, table = load_study("methods"), read_table(folder)
    methods, tasks = make_methods(study, table), [task.name for task in study.spec.tasks]
    print_table(tasks, [[one.name, *(formed(one, one.outcomes[task]) for task in tasks)] for one in methods])
    print_table(
        [*tasks, "numbers"],
        [[one.name, *(way(one.outcomes[task]) for task in tasks), numbers(one)] for one in methods],
    )
    print_failures([row for row in table.to_pylist() if row["sweep"] == OURS])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
