"""Files of tables: CSV and Parquet, written row group by row group."""

import csv
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from skyherd.files.atomic import whole_file
from skyherd.jobs.progress import Progress
from skyherd.plugins import import_extra
from skyherd.recording.export.recorded_run import RecordedRun
from skyherd.recording.export.tables import Rows, TableSpec, rows_of_moment, tables_of
from skyherd.text import table_cell

GROUP_ROWS = 1 << 16
"""Rows of a row group of a Parquet file. Chosen: some 10 MB of detections, which fit any memory."""


class TableFile(Protocol):
    """An open file of one table."""

    def add(self, rows: Rows) -> None:
        """Append rows."""


Opener = Callable[[Path, TableSpec], AbstractContextManager[TableFile]]
"""Function that opens the file of a table; the file gets its name when it is complete."""


def write_tables(
    run: RecordedRun, folder: Path, suffix: str, opener: Opener, progress: Progress
) -> dict[str, int]:
    """Write all tables of a run, and return the number of rows of each.

    Args:
        run: the run.
        folder: an existing folder.
        suffix: of the files, such as `.csv`.
        opener: opens the file of a table.
        progress: receives the time in the run.

    Raises:
        OutputError: a file cannot be written.
    """
    specs = tables_of(run.kind)
    counts = dict.fromkeys((spec.name for spec in specs), 0)
    with ExitStack() as stack:
        files = {
            spec.name: stack.enter_context(opener(folder / f"{spec.name}{suffix}", spec)) for spec in specs
        }
        for moment in run.moments():
            progress.update(run.name, moment.time_s, run.end_s, f"{moment.time_s:.0f}/{run.end_s:.0f} s")
            for spec, rows in rows_of_moment(moment):
                if count := _length(rows):
                    files[spec.name].add(rows)
                    counts[spec.name] += count
    return counts


def _length(rows: Rows) -> int:
    return next(len(values) for values in rows.values() if isinstance(values, list | np.ndarray))


def _columns(rows: Rows, spec: TableSpec) -> list[list[Any]]:
    """Return the values of each column as a list, in the order of columns; NaN becomes None."""
    count = _length(rows)
    return [_values(rows[column.name], count) for column in spec.columns]


def _values(values: Any, count: int) -> list[Any]:
    listed = values.tolist() if isinstance(values, np.ndarray) else values
    if not isinstance(listed, list):
        listed = [listed] * count
    return [None if value != value else value for value in listed]


class _CsvFile:
    """A CSV file. Numbers have all digits that distinguish them, and missing values are empty."""

    def __init__(self, stream: Any, spec: TableSpec) -> None:
        self._spec = spec
        self._writer = csv.writer(stream, lineterminator="\n")
        self._writer.writerow(spec.meanings)

    def add(self, rows: Rows) -> None:
        """Append rows."""
        columns = [
            [_CSV_TEXTS[column.kind](value) if value is not None else "" for value in values]
            for column, values in zip(self._spec.columns, _columns(rows, self._spec), strict=True)
        ]
        self._writer.writerows(zip(*columns, strict=True))


_CSV_TEXTS: dict[str, Callable[[Any], Any]] = {
    "int": int,
    "float": float,
    "text": table_cell,
    "bool": lambda value: "true" if value else "false",
}
"""Conversion of a value to a cell by the type of its column."""


@contextmanager
def open_csv(path: Path, spec: TableSpec) -> Iterator[TableFile]:
    """Open the CSV file of a table; it gets its name when it is complete.

    Raises:
        OutputError: it cannot be written.
    """
    with whole_file(path) as part, part.open("w", encoding="utf-8", newline="") as stream:
        yield _CsvFile(stream, spec)


class _ParquetFile:
    """A Parquet file. The meaning of each column is in its metadata, and missing values are null."""

    def __init__(self, arrow: Any, writer: Any, schema: Any, spec: TableSpec) -> None:
        self._arrow, self._writer, self._schema, self._spec = arrow, writer, schema, spec
        self._pending: list[list[Any]] = [[] for _ in spec.columns]

    def add(self, rows: Rows) -> None:
        """Append rows."""
        for pending, values in zip(self._pending, _columns(rows, self._spec), strict=True):
            pending += values
        if len(self._pending[0]) >= GROUP_ROWS:
            self.flush()

    def flush(self) -> None:
        """Write the pending rows as a row group."""
        if self._pending[0]:
            arrays = [
                self._arrow.array(values, field.type)
                for values, field in zip(self._pending, self._schema, strict=True)
            ]
            self._writer.write_table(self._arrow.Table.from_arrays(arrays, schema=self._schema))
            self._pending = [[] for _ in self._pending]


def parquet_opener() -> Opener:
    """Return the function that opens the Parquet file of a table.

    Raises:
        InputError: pyarrow is not installed.
    """
    arrow = import_extra("pyarrow", "pyarrow", "kind: parquet", "export")
    parquet = import_extra("pyarrow.parquet", "pyarrow", "kind: parquet", "export")
    types = {"int": arrow.int64(), "float": arrow.float64(), "text": arrow.string(), "bool": arrow.bool_()}

    @contextmanager
    def open_parquet(path: Path, spec: TableSpec) -> Iterator[TableFile]:
        schema = arrow.schema(
            [
                arrow.field(column.name, types[column.kind], metadata={"meaning": column.meaning})
                for column in spec.columns
            ]
        )
        with whole_file(path) as part, parquet.ParquetWriter(part, schema, compression="zstd") as writer:
            table = _ParquetFile(arrow, writer, schema, spec)
            yield table
            table.flush()

    return open_parquet
