"""Rows of a benchmark over many seeds: run in parallel, written as they end, and resumed."""

import json
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from skyherd.files.atomic import write_text

Row = dict[str, Any]


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a file, without an unfinished last line."""
    rows = []
    for line in path.read_text().splitlines() if path.exists() else []:
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            break
    return rows


def gather(run: Callable[[int], Row], seeds: range, jobs: int, path: Path | None) -> list[Row]:
    """Return all rows of `seeds`: those of the file, and the missing ones as they end."""
    rows = [row for row in read_rows(path) if row["seed"] in seeds] if path else []
    done = {row["seed"] for row in rows}
    if path and path.exists():
        whole = "".join(json.dumps(row) + "\n" for row in read_rows(path))
        write_text(path, whole)
    for row in _run(run, [seed for seed in seeds if seed not in done], jobs):
        line = json.dumps(row)
        print(line, file=sys.stderr, flush=True)
        rows.append(row)
        if path:
            with path.open("a") as file:
                file.write(line + "\n")
    return rows


def _run(run: Callable[[int], Row], seeds: list[int], jobs: int) -> Iterator[Row]:
    if jobs == 1:
        yield from map(run, seeds)
        return
    with ProcessPoolExecutor(jobs) as pool:
        for future in as_completed([pool.submit(run, seed) for seed in seeds]):
            yield future.result()
