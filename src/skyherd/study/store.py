"""Outcomes on disk: small Parquet files that are either whole or not there.

A part is written under another name and then renamed, so that a process that is killed at any instant loses
at most what it had not yet written. Parts are numbered, and the last outcome of a run counts.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import locket
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from skyherd.errors import InputError, OutputError
from skyherd.files.atomic import write_text, write_whole
from skyherd.study.measure import Outcome

PARTS, LOCK, MARK = "parts", ".lock", "study.json"
"""Names in a study's folder: the folder of parts, the lock file, and the file that says which study it is."""

KEY, ERROR = "key", "error"
"""Columns that every outcome has."""


class Store:
    """The outcomes in a study's folder. Only a store from `open_store` may be written to."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / PARTS

    def append(self, outcomes: Sequence[Outcome]) -> None:
        """Write outcomes as one part; OutputError if it cannot be written."""
        names = dict.fromkeys(name for outcome in outcomes for name in outcome)
        columns = {name: [_plain(outcome.get(name)) for outcome in outcomes] for name in names}
        self._write(pa.table(columns))

    def keys(self, columns: Sequence[str] = (), *, failed: bool = True) -> set[str]:
        """Keys of the runs whose outcome is stored.

        Args:
            columns: only runs with a value in all of these.
            failed: runs that ended with an error as well.
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
        """Read all outcomes, one row a run, the last one of each."""
        tables = [_read(path) for path in self._paths()]
        if not tables:
            return pa.table({KEY: pa.array([], pa.string()), ERROR: pa.array([], pa.string())})
        table = pa.concat_tables(tables, promote_options="permissive")
        last = {key: row for row, key in enumerate(table[KEY].to_pylist())}
        return table.take(sorted(last.values()))

    def compact(self) -> None:
        """Replace all parts by one, written before the others are removed, so that no row is missing."""
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
        return sorted(self.folder.glob("[0-9]*.parquet"))


def write_parquet(table: pa.Table, path: Path) -> Path:
    """Write a table to a Parquet file, whole or not at all; OutputError if it cannot be written."""
    return write_whole(path, lambda part: pq.write_table(table, part, compression="zstd"))


@contextmanager
def open_store(folder: Path, mark: str) -> Iterator[Store]:
    """Open the store in a folder for one process at a time, and write `mark` to `study.json` beside it.

    Raises:
        InputError: the folder holds something else, or another process uses it.
        OutputError: it cannot be written to.
    """
    if _is_foreign(folder):
        raise InputError(str(folder), "holds something else", "a new folder, or that of a study; see --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = locket.lock_file(str(folder / LOCK), timeout=0)
        lock.acquire()
    except locket.LockError:
        raise InputError(
            str(folder), "another study is at work in it", "wait for it, or another --out"
        ) from None
    except OSError as error:
        raise OutputError(f"{folder}: {error.strerror or error}; choose another --out") from None
    try:
        write_text(folder / MARK, mark)
        (folder / PARTS).mkdir(exist_ok=True)
        for part in (folder / PARTS).glob(".*.part"):  # of a process that was killed
            part.unlink(missing_ok=True)
        yield Store(folder)
    finally:
        lock.release()


def _read(path: Path) -> pa.Table:
    try:
        return pq.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        why = " ".join(str(error).split())[:80]
        raise InputError(str(path), f"damaged: {why}", "remove it, and its runs are made again") from None


def _is_foreign(folder: Path) -> bool:
    """Whether the folder has content that is not of a study."""
    if not folder.exists() or (folder / MARK).exists():
        return False
    return not folder.is_dir() or any(entry.name not in {LOCK, f".{MARK}.part"} for entry in folder.iterdir())


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value
