"""Result of a benchmark: rows, environment, and selections for tables and plots."""

import json
import os
import platform
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from skyherd.bench.detectors.design import EMPTY, GRID, Cell, Sweep
from skyherd.bench.entrants import is_ours
from skyherd.errors import InputError
from skyherd.files.atomic import write_text
from skyherd.files.reading import read_json

RESULT = "bench.json"
"""File name of a result in its folder."""

Row = dict[str, Any]
"""One detector in one cell: the cell's factors, its `skyherd.bench.detectors.scorer.Score`, and its times."""

PACKAGES = {
    "opencv": ("opencv-python-headless", "opencv-python"),
    "pupil-apriltags": ("pupil-apriltags",),
    "locus-tag": ("locus-tag",),
    "napa-vision": ("napa-vision",),
}
"""Alternative package names of a program, of which one is installed, by the name in the result."""


@dataclass(frozen=True)
class Result:
    """Content of `bench.json`.

    Attributes:
        environment: versions of programs, the machine, and the options of the run.
        cells: a row for each detector and cell.
        timing: a row for each detector and resolution, clean and noisy.
    """

    environment: dict[str, Any]
    cells: list[Row]
    timing: list[Row]

    @property
    def detectors(self) -> list[str]:
        """Names of the detectors, skyherd's own first, else in the order measured."""
        names = list(dict.fromkeys(row["detector"] for row in [*self.cells, *self.timing]))
        return sorted(names, key=lambda name: not is_ours(name))

    def noises(self) -> list[float]:
        """Return the noises of the grid, grey levels, ascending."""
        return sorted({row["noise"] for row in self.cells if row["sweep"] == GRID})

    def by_side(self, detector: str, noise: float) -> list[Row]:
        """Return a detector's rows of the grid at one noise, ascending by marker side."""
        rows = [r for r in self.cells if (r["sweep"], r["detector"], r["noise"]) == (GRID, detector, noise)]
        return sorted(rows, key=lambda row: float(row["side_px"]))

    def along(self, sweep: Sweep, detector: str) -> list[tuple[float, Row]]:
        """Return a detector's rows along a sweep, by value, with the base cell if it belongs to it."""
        rows = [row for row in self.cells if row["detector"] == detector]
        found = [(float(row[sweep.key]), row) for row in rows if row["sweep"] == sweep.name]
        if getattr(Cell(), sweep.key) is not None and not sweep.fixed:
            found += [(float(row[sweep.key]), row) for row in rows if row["sweep"] == "base"]
        return sorted(found, key=lambda pair: pair[0])

    def empty_clutter(self, detector: str) -> Row | None:
        """Return a detector's row for images of clutter without a marker; None without one."""
        return next((r for r in self.cells if (r["sweep"], r["detector"]) == (EMPTY, detector)), None)

    def write(self, folder: Path) -> Path:
        """Write `bench.json` into a folder and return its path; OutputError if it cannot be written."""
        content = {"environment": self.environment, "rows": self.cells, "timing": self.timing}
        return write_text(folder / RESULT, json.dumps(content, indent=1) + "\n")


def read_result(folder: Path) -> Result:
    """Read `bench.json` of a folder; InputError if it is missing or not a result."""
    path = folder / RESULT
    try:
        content = read_json(path, f"a {RESULT} of `skyherd bench`, in its output folder")
        return Result(content["environment"], content["rows"], content["timing"])
    except (KeyError, TypeError) as error:
        raise InputError(str(path), f"cannot be read: {error}", f"a {RESULT} of `skyherd bench`") from None


def environment(**asked: object) -> dict[str, Any]:
    """Return versions of programs and the machine for a result, after the options `asked` of the run."""
    programs = {name: _first_version(packages) for name, packages in PACKAGES.items()}
    return {
        **asked,
        "skyherd": _first_version(("skyherd",)),
        "python": platform.python_version(),
        "numpy": _first_version(("numpy",)),
        **programs,
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads_per_detector": 1,
    }


def _first_version(packages: Iterable[str]) -> str | None:
    for package in packages:
        try:
            return version(package)
        except PackageNotFoundError:
            continue
    return None


def _processor() -> str:
    """Return the processor's name; `not known` if the system does not state it."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or "not known"
