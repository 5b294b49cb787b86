"""Outcomes of a study of formation controllers, method by method and task by task.

`control.method` of a scenario replaces the robots' own control by a law from the literature
(`skyherd.sim.baseline_laws`). Such a team (`skyherd.sim.oracle_team`) reads the true positions of the robots
from the world and drives the same wheels. It is outside `skyherd.control`, which therefore never imports the
simulation.

The study `methods` runs each law on the same tasks from the same starts. This package compares the outcomes:
`outcomes.py` reads the study's table, `plots.py` draws them, `paths.py` draws the robots' paths, and
`page.py` tabulates them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pyarrow as pa

from skyherd.geometry import Array, BoolArray
from skyherd.study.parts import SweepModel
from skyherd.study.spec import CURVE, Study
from skyherd.study.store import ERROR
from skyherd.study.table import SWEEP, TASK

METHOD, UNITS_LAW = "control.method", "similarity"
"""Key of a scenario's control law, and its value for control by the aerial units from their images."""

Row = Mapping[str, Any]
"""A row of the study's table, by column."""


@dataclass(frozen=True)
class Outcomes:
    """All runs of one method on one task. R of them finished without an error.

    Attributes:
        begun_s: (R,) times at which robots may begin to move. Robots of the units' law wait for a complete
            tree of units; robots that know the true positions begin at once.
        converged: (R,) True if the shape was formed, at any position, rotation and size, and held to the end.
        affine: (R,) True if an affine image of the shape was formed and held to the end.
        times_s: (R,) convergence time: from `begun_s` until the shape error stays under its goal; NaN if it
            does not.
        affine_times_s: (R,) the same for the nearest affine image.
        errors: (R,) final shape error.
        affine_errors: (R,) final distance from the nearest affine image, over the same radius.
        paths_m: (R,) total path length of all robots.
        detours: (R,) that length over the lower bound for forming the shape from this start.
        gaps_m: (R,) least distance between the edges of two bodies; negative in overlaps.
        collided: (R,) True if bodies overlapped at any time.
        messages_ps: (R,) messages per robot and second.
        numbers_ps: (R,) numbers in them, per robot and second.
        waypoints_m: (W, N, 2) robots' positions from start to end in the first of the runs; None without any.
        failed: number of runs that ended with an error.
    """

    begun_s: Array
    converged: BoolArray
    affine: BoolArray
    times_s: Array
    affine_times_s: Array
    errors: Array
    affine_errors: Array
    paths_m: Array
    detours: Array
    gaps_m: Array
    collided: BoolArray
    messages_ps: Array
    numbers_ps: Array
    waypoints_m: Array | None
    failed: int


@dataclass(frozen=True)
class Method:
    """One formation controller: its name, required knowledge, and outcomes by the task's name."""

    name: str
    needs: str
    outcomes: Mapping[str, Outcomes]


def make_methods(study: Study, table: pa.Table) -> list[Method]:
    """Return the methods and outcomes in a study's table, in the order of the study's sweeps.

    A sweep is a method. One with a grid is a method for each of its combinations, such as of gains. The table
    needs the columns that `skyherd.study.spec.METHODS_KEEPS` names.
    """
    rows = table.to_pylist()
    return [
        Method(
            ", ".join([sweep.name, *(f"{key.rpartition('.')[2]} = {value:g}" for key, value in own.items())]),
            sweep.about,
            {task.name: _outcomes(_rows_of(rows, sweep, task.name, own)) for task in study.spec.tasks},
        )
        for sweep in study.spec.all_sweeps
        for own in _combinations(sweep)
    ]


def _combinations(sweep: SweepModel) -> list[dict[str, Any]]:
    return [dict(zip(sweep.grid, values, strict=True)) for values in product(*sweep.grid.values())]


def _rows_of(rows: Sequence[Row], sweep: SweepModel, task: str, own: Mapping[str, Any]) -> list[Row]:
    return [
        row
        for row in rows
        if row[SWEEP] == sweep.name
        and row[TASK] == task
        and all(row[key] == value for key, value in own.items())
    ]


def _outcomes(rows: Sequence[Row]) -> Outcomes:
    good = [row for row in rows if row[ERROR] is None]

    def column(name: str) -> Array:
        return np.array([np.nan if row[name] is None else row[name] for row in good], dtype=float)

    waits = np.array([row.get(METHOD, UNITS_LAW) == UNITS_LAW for row in good], dtype=bool)
    begun_s = np.where(waits, np.nan_to_num(column("ready_s")), 0.0)
    converged, affine_s = column("converged") > 0, column(f"{CURVE}affine_reached_s")
    return Outcomes(
        begun_s=begun_s,
        converged=converged,
        affine=np.isfinite(affine_s),
        times_s=np.where(converged, column("reached_s") - begun_s, np.nan),
        affine_times_s=np.maximum(affine_s - begun_s, 0.0),
        errors=column("shape_error"),
        affine_errors=np.array([row[f"{CURVE}affine_error"][-1] for row in good], dtype=float),
        paths_m=column("path_length_m"),
        detours=column("path_length_m") / column(f"{CURVE}min_path_m"),
        gaps_m=column("min_gap_m"),
        collided=column("collisions") > 0,
        messages_ps=column(f"{CURVE}messages_per_robot_s"),
        numbers_ps=column(f"{CURVE}numbers_per_robot_s"),
        waypoints_m=np.array(good[0][f"{CURVE}waypoints_m"]) if good else None,
        failed=len(rows) - len(good),
    )
