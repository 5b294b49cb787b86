"""What a study of formation controllers measured, method by method and start by start.

`control.method` of a scenario puts a control law from the literature (`skyherd.sim.baseline_laws`) in the
place of the robots' own. Such a team (`skyherd.sim.oracle_team`) reads the true places of the robots from the
world and drives the same wheels; it stands outside `skyherd.control`, which therefore never imports anything
of the simulation. The study `methods` runs each law from the same starts, and this package compares the
outcomes: `outcomes.py` reads the study's table, `plots.py` draws them, `page.py` writes them down.

The complex Laplacian that one of the laws uses is a sum over the triangles of the shape. It is Hermitian and
positive semidefinite, so that the law is stable without the diagonal stabilising matrix that other choices of
weights need.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from skyherd.datasets import ScatterModel
from skyherd.geometry import Array, BoolArray
from skyherd.study.spec import METHODS_START, Study
from skyherd.study.store import ERROR
from skyherd.study.table import SWEEP

METHOD, UNITS_LAW = "control.method", "similarity"
"""Key of a scenario's control law, and its value where the aerial units control the robots from their
images."""

Row = Mapping[str, Any]
"""A row of the study's table, by column."""


@dataclass(frozen=True)
class Outcomes:
    """All runs of one method from one kind of start. R of them finished without an error.

    Attributes:
        begun_s: (R,) when robots may begin to move. Robots of the units' law wait for the tree of units to be
            complete; robots that know the true places begin at once.
        converged: (R,) whether the shape was formed, and held to the end.
        times_s: (R,) time from `begun_s` until the shape error stays under its goal; NaN if it does not.
        paths_m: (R,) length of the paths of all robots together.
        gaps_m: (R,) least distance between the edges of two bodies; negative where they overlapped.
        collided: (R,) whether bodies overlapped at any time.
        failed: number of runs that ended with an error.
    """

    begun_s: Array
    converged: BoolArray
    times_s: Array
    paths_m: Array
    gaps_m: Array
    collided: BoolArray
    failed: int


@dataclass(frozen=True)
class Method:
    """One formation controller: its name, what it needs to know, and its outcomes by label of the start."""

    name: str
    needs: str
    outcomes: Mapping[str, Outcomes]


def make_methods(study: Study, table: pa.Table) -> list[Method]:
    """The methods of a study and their outcomes, in the order of the study's sweeps, from the study's table.

    The table needs the columns that `skyherd.study.spec.METHODS_KEEPS` names.
    """
    rows = table.to_pylist()
    return [
        Method(
            sweep.name,
            sweep.about,
            {
                start_label(start): _outcomes(
                    [row for row in rows if row[SWEEP] == sweep.name and _start_of(row) == start]
                )
                for start in map(ScatterModel.model_validate, sweep.grid[METHODS_START])
            },
        )
        for sweep in study.spec.all_sweeps
    ]


def start_label(scatter: ScatterModel) -> str:
    """A kind of start in words: robots anywhere, or each near its own place in the shape.

    Robots start at the shape, enlarged to `scale_m` metres a template unit, each moved by up to `jitter_m`
    along x and along y. Where that is more than twice `scale_m`, nothing of the shape is left: `anywhere`.
    """
    if scatter.scale_m < scatter.jitter_m / 2:
        return f"anywhere within {scatter.jitter_m:g} m"
    return f"near its place, {scatter.scale_m:g} m a unit"


def _start_of(row: Row) -> ScatterModel:
    return ScatterModel.model_validate(json.loads(row[METHODS_START]))


def _outcomes(rows: Sequence[Row]) -> Outcomes:
    good = [row for row in rows if row[ERROR] is None]

    def column(name: str) -> Array:
        return np.array([np.nan if row[name] is None else row[name] for row in good], dtype=float)

    waits = np.array([row.get(METHOD, UNITS_LAW) == UNITS_LAW for row in good], dtype=bool)
    begun_s = np.where(waits, np.nan_to_num(column("ready_s")), 0.0)
    converged = column("converged") > 0
    return Outcomes(
        begun_s=begun_s,
        converged=converged,
        times_s=np.where(converged, column("reached_s") - begun_s, np.nan),
        paths_m=column("path_length_m"),
        gaps_m=column("min_gap_m"),
        collided=column("collisions") > 0,
        failed=len(rows) - len(good),
    )
