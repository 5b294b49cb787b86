"""What a study of formation controllers measured, method by method and start by start."""

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
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Outcomes:
    """All runs of one method from one kind of start; R of them went well.

    Attributes:
        begun_s: (R,) when robots may move: once the units' tree is complete.
        converged: (R,) whether the shape was formed, and held to the end.
        times_s: (R,) from when robots may move until the error stays under its goal; NaN if it does not.
        paths_m: (R,) length of all robots' ways together.
        gaps_m: (R,) least room between two bodies.
        collided: (R,) whether bodies overlapped.
        failed: runs that broke.
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
    """One formation controller: its name, what it needs to know, and its runs by start."""

    name: str
    needs: str
    outcomes: Mapping[str, Outcomes]


def make_methods(study: Study, table: pa.Table) -> list[Method]:
    """The methods of a study, in its order, from its table."""
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
    """Words for a start: robots anywhere, or near the places that are theirs."""
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
