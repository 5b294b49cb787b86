"""Outcomes on disk: small Parquet files that are complete or absent.

A part is written under another name and then renamed, so that a process that is killed at any instant loses
only unwritten outcomes. Parts are numbered, and the last outcome of a run counts.
"""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from skyherd.errors import InputError
from skyherd.files.atomic import PART, write_text, write_whole
from skyherd.files.folder_record import RECORD
from skyherd.files.output_folder import OutputFolder
from skyherd.files.reading import is_regular, open_regular
from skyherd.study.measure import Outcome

PARTS, MARK = "parts", "study.json"
"""Names in a study's folder: the folder of parts, and the file that identifies the study."""

PART_NAME = re.compile(r"[0-9]{8}\.parquet")
"""Names of the parts, which are numbered."""

VERB = "study"
"""Verb under which the record of output folders (`skyherd.files.output_folder`) lists a study's files."""

KEY, ERROR = "key", "error"
"""Columns that every outcome has."""


class Store:
    """Outcomes in a study's folder. Only a store from `open_store` is writable."""

    def __init__(self, folder: Path, on_append: Callable[[], None] = lambda: None) -> None:
        self.folder = folder / PARTS
        self._on_append = on_append

    def append(self, outcomes: Sequence[Outcome]) -> None:
        """Write outcomes as one part; OutputError if it cannot be written."""
        names = dict.fromkeys(name for outcome in outcomes for name in outcome)
        columns = {name: [_plain(outcome.get(name)) for outcome in outcomes] for name in names}
        self._write(pa.table(columns))
        self._on_append()

    def keys(self, columns: Sequence[str] = (), *, failed: bool = True) -> set[str]:
        """Return the keys of the runs whose outcome is stored.

        Args:
            columns: only runs with a value in all of these.
            failed: include failed runs.
        """
        table = self.read()
        if any(name not in table.column_names for name in columns):
            whole = [False] * table.num_rows
        else:
            valid = [table[name].is_valid().to_pylist() for name in columns]
            whole = [all(row) for row in zip(*valid, strict=True)] if valid else [True] * table.num_rows
        errors = table[ERROR].to_pylist()
        return {
            key
            for key, error, complete in zip(table[KEY].to_pylist(), errors, whole, strict=True)
            if (complete if error is None else failed)
        }

    def read(self) -> pa.Table:
        """Read all outcomes, one row per run, the last one of each."""
        tables = [_read(path) for path in self._paths()]
        if not tables:
            return pa.table({KEY: pa.array([], pa.string()), ERROR: pa.array([], pa.string())})
        try:
            table = pa.concat_tables(tables, promote_options="permissive")
        except pa.ArrowException as error:
            what = f"parts that do not go together: {' '.join(str(error).split())}"
            raise InputError(str(self.folder), what, "remove it to make all runs again") from None
        last = {key: row for row, key in enumerate(table[KEY].to_pylist())}
        return table.take(sorted(last.values()))

    def compact(self) -> None:
        """Replace all parts by one, written before the others are removed, so that no row is lost."""
        paths = self._paths()
        if len(paths) > 1:
            self._write(self.read())
            for path in paths:
                path.unlink()

    def _write(self, table: pa.Table) -> None:
        paths = self._paths()
        number = 1 + (int(paths[-1].stem) if paths else 0)
        write_parquet(table, self.folder / f"{number:08d}.parquet")

    def _paths(self) -> list[Path]:
        return sorted(path for path in self.folder.glob("*.parquet") if PART_NAME.fullmatch(path.name))


def write_parquet(table: pa.Table, path: Path) -> Path:
    """Write a table to a Parquet file atomically; OutputError if it cannot be written."""
    return write_whole(path, lambda part: pq.write_table(table, part, compression="zstd"))


def check_store(folder: Path, names: Sequence[str] = ()) -> OutputFolder:
    """Return the output folder of a study, not entered; arguments as `open_store`. Change nothing.

    Raises:
        InputError: the folder holds something else, or a foreign file that would be replaced.
    """
    if _is_foreign(folder):
        raise InputError(
            str(folder), "is not the folder of a study", "another `folder=`: a new one, or that of a study"
        )
    output = OutputFolder(folder, VERB, [MARK, f"{PARTS}/", *names], resume=True)
    output.check()
    return output


@contextmanager
def open_store(folder: Path, mark: str, names: Sequence[str] = ()) -> Iterator[Store]:
    """Open the store in a folder for one process at a time, and write `mark` to `study.json`.

    If the body of the `with` fails before the first outcome in a new folder, nothing is left of it.

    Args:
        folder: a new folder, or that of a study.
        mark: content of `study.json`, which identifies the study.
        names: additional outputs in the folder.

    Raises:
        InputError: as `check_store` does, or another process uses the folder.
        OutputError: it cannot be written to.
    """
    with check_store(folder, names) as output:
        write_text(folder / MARK, mark)
        (folder / PARTS).mkdir(exist_ok=True)
        yield Store(folder, on_append=output.keep)


def _read(path: Path) -> pa.Table:
    """Read a part; InputError if `Store.append` did not write it."""
    advice = "remove it, and its runs are made again"
    try:
        with open_regular(path, advice) as stream:
            table = pq.read_table(stream)
    except InputError:
        raise
    except (pa.ArrowException, OSError, ValueError) as error:
        raise InputError(str(path), f"damaged: {' '.join(str(error).split())}", advice) from None
    for name in (KEY, ERROR):
        if name not in table.column_names:
            raise InputError(str(path), f"damaged: no column {name}", advice)
        if not (pa.types.is_string(table[name].type) or pa.types.is_null(table[name].type)):
            raise InputError(str(path), f"damaged: column {name} is not text", advice)
    if table[KEY].null_count:
        raise InputError(str(path), f"damaged: a row without a {KEY}", advice)
    return table


def _is_foreign(folder: Path) -> bool:
    """Return whether the folder has content that does not belong to a study."""
    if not os.path.isdir(folder) or is_regular(folder / MARK):
        return False
    return any(entry.name != RECORD and not PART.fullmatch(entry.name) for entry in folder.iterdir())


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value
