"""Print the tables of docs/methods.md, and the seeds of the starts in which skyherd failed.

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
AFFINE = "affine"
"""Begin of the names of methods that promise an affine image of the shape and no more."""

EQUAL = ", equal"
"""End of the names of methods with the roles and the avoidance of skyherd."""

SIDE_M, BODY_M, MARGIN_M = 0.4, 0.4, 0.08
"""Side of a marker, radius of a robot's body and margin of the avoidance, m, in every task of the study."""

MOVED_M = 0.005
"""Displacement below which a robot counts as standing, m. Chosen: a hundredth of its body."""


def formed(runs: Outcomes) -> str:
    """Return the number of starts that formed the shape."""
    return f"{int(runs.converged.sum())}"


def image_formed(runs: Outcomes) -> str:
    """Return the number of starts that formed an affine image of the shape."""
    return f"{int(runs.affine.sum())}"


def formed_rows(methods: list[Method], tasks: list[str]) -> list[list[str]]:
    """Return rows of counts; affine laws have a second row for affine images."""
    rows = []
    for one in methods:
        rows.append([one.name, *(formed(one.outcomes[task]) for task in tasks)])
        if one.name.startswith(AFFINE):
            rows.append([f"{one.name}: affine image", *(image_formed(one.outcomes[task]) for task in tasks)])
    return rows


def time(method: Method, runs: Outcomes) -> str:
    """Return the median time from the start, s, of the starts that formed what the method promises."""
    promised = method.name.startswith(AFFINE)
    if not (runs.affine if promised else runs.converged).any():
        return "–"
    return f"{median(runs.begun_s + (runs.affine_times_s if promised else runs.times_s)):.3g}"


def end_error(method: Method, runs: Outcomes) -> str:
    """Return the median error at the end, %, of the shape or of its affine image."""
    errors = runs.affine_errors if method.name.startswith(AFFINE) else runs.errors
    return f"{100 * median(errors):.2g}"


def path_ratio(runs: Outcomes) -> str:
    """Return the median path over the shortest."""
    return f"{median(runs.detours):.2g}"


def collided(runs: Outcomes) -> str:
    """Return the number of starts with collisions."""
    return f"{int(runs.collided.sum())}"


def numbers(method: Method) -> str:
    """Return the range of the tasks' median numbers per robot and second, as `336 to 624`."""
    each = [median(runs.numbers_ps) for runs in method.outcomes.values()]
    return f"{min(each):.0f} to {max(each):.0f}"


def print_table(head: list[str], rows: list[list[str]]) -> None:
    """Print a Markdown table whose first column has no title."""
    for line in ["", *head], ["---"] * (len(head) + 1), *rows:
        print(f"| {' | '.join(line)} |")
    print()


def start_gap_m(row: dict[str, Any]) -> float:
    """Return the smallest gap between two bodies at the start of a run, obstacles included, m."""
    places_m = np.array(row["history.waypoints_m"][0])
    obstacles = row["obstacles"] or []
    others_m = np.array([*places_m, *(one["position_m"] for one in obstacles)])
    radii_m = np.array([*[BODY_M] * len(places_m), *(SIDE_M * one["radius_sides"] for one in obstacles)])
    gaps_m = np.linalg.norm(others_m - places_m[:, None], axis=-1) - BODY_M - radii_m
    np.fill_diagonal(gaps_m, np.inf)
    return float(gaps_m.min())


def still(row: dict[str, Any]) -> list[int]:
    """Return the robots that did not move."""
    ways_m = np.array(row["history.waypoints_m"])
    farthest_m = np.linalg.norm(ways_m - ways_m[0], axis=-1).max(axis=0)
    return [int(robot) for robot in np.flatnonzero(farthest_m < MOVED_M)]


def print_sets(rows: list[dict[str, Any]], ours: list[Method], tasks: list[str]) -> None:
    """Print the median size of the largest control set at the end, per variant of skyherd and task."""
    sizes = {(one.name, task): [] for one in ours for task in tasks}
    for row in rows:
        if (row["sweep"], row["task"]) in sizes:
            sizes[row["sweep"], row["task"]].append(row["history.largest_set"])
    medians = [[one.name, *(f"{np.median(sizes[one.name, task]):.0f}" for task in tasks)] for one in ours]
    print_table(tasks, medians)


def print_failures(rows: list[dict[str, Any]]) -> None:
    """Print the failed runs, and the runs that formed by whether they began inside the margin."""
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
    """Print the figures of docs/methods.md that the tables of the study do not have."""
    study, table = load_study("methods"), read_table(folder)
    methods, tasks = make_methods(study, table), [task.name for task in study.spec.tasks]
    ours = [one for one in methods if one.name.startswith(OURS)]
    equal = [one for one in methods if one.name.endswith(EQUAL)]
    plain = [one for one in methods if one not in (*ours, *equal)]
    for group in ours, plain, [ours[0], *equal]:
        print_table(tasks, formed_rows(group, tasks))
        for value in time, end_error:
            print_table(
                tasks, [[one.name, *(value(one, one.outcomes[task]) for task in tasks)] for one in group]
            )
        for count in path_ratio, collided:
            print_table(tasks, [[one.name, *(count(one.outcomes[task]) for task in tasks)] for one in group])
    print_table(["numbers"], [[one.name, numbers(one)] for one in methods])
    print_sets(table.to_pylist(), ours, tasks)
    print_failures([row for row in table.to_pylist() if row["sweep"] == OURS])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
