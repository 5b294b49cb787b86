"""Table of a study: one row per run, in the study's order, with parameters and stored values."""

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from skyherd.errors import InputError
from skyherd.study.plan import Plan
from skyherd.study.spec import CURVE
from skyherd.study.store import ERROR, KEY

TABLE = "table.parquet"
"""File name of the table, in the study's folder."""

SWEEP = "sweep"
"""Column of the sweep's name, in tables of studies that have sweeps."""

TASK = "task"
"""Column of the task's name, in tables of studies that have tasks."""

Row = dict[str, Any]
"""A row of the table, by column."""


def make_table(plan: Plan, outcomes: pa.Table) -> pa.Table:
    """Make a study's table of its outcomes.

    Args:
        plan: the study and its runs.
        outcomes: one row for each of them, in any order; others are left out.

    Returns:
        a table with the columns `sweep` (if the study has sweeps), `task` (if it has tasks), every parameter,
        every stored field, `error`, `key`.
    """
    place = {key: row for row, key in enumerate(outcomes[KEY].to_pylist())}
    rows = outcomes.take([place[run.key] for run in plan.runs])
    spec = plan.study.spec
    columns = {SWEEP: _column([run.sweep for run in plan.runs])} if spec.sweeps else {}
    columns |= {TASK: _column([run.task for run in plan.runs])} if spec.tasks else {}
    columns |= {key: _column([run.parameters[key] for run in plan.runs]) for key in spec.parameters}
    for name in (*spec.keep, ERROR, KEY):
        there = name in rows.column_names
        columns.setdefault(name, rows[name].combine_chunks() if there else pa.nulls(rows.num_rows))
    return pa.table(columns)


def read_table(folder: Path) -> pa.Table:
    """Read the table in the folder of a finished study.

    Raises:
        InputError: it is missing or damaged.
    """
    try:
        return pq.read_table(folder / TABLE)
    except (pa.ArrowException, OSError):
        raise InputError(
            str(folder / TABLE), "missing or damaged", "the folder of a finished study"
        ) from None


def good_rows(table: pa.Table) -> list[Row]:
    """Return the rows of runs without an error, without their arrays over time."""
    names = [name for name in table.column_names if not name.startswith(CURVE)]
    return [row for row in table.select(names).to_pylist() if row[ERROR] is None]


def _column(values: list[Any]) -> pa.Array:
    """Return a column of values; as JSON texts if they have no common type."""
    if not any(isinstance(value, dict) for value in values):
        try:
            return pa.array(values)
        except (pa.ArrowInvalid, pa.ArrowTypeError):
            pass
    return pa.array([json.dumps(value) for value in values])
