"""The result of a run: its rows, what made them, and the questions that tables and plots ask of them."""

import json
import os
import platform
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from skyherd.bench.design import EMPTY, GRID, Cell, Sweep
from skyherd.bench.entrants import is_ours
from skyherd.errors import InputError
from skyherd.files.atomic import write_text

RESULT = "bench.json"
Row = dict[str, Any]
PACKAGES = {"opencv": ("opencv-python-headless", "opencv-python"), "pupil-apriltags": ("pupil-apriltags",)}


@dataclass(frozen=True)
class Result:
    """What `bench.json` holds.

    Attributes:
        environment: programs, machine, and how the run was asked for.
        cells: a row for each detector and cell.
        timing: a row for each detector and resolution, clean and noisy.
    """

    environment: dict[str, Any]
    cells: list[Row]
    timing: list[Row]

    @property
    def detectors(self) -> list[str]:
        """Names, ours first, each in the order entered."""
        names = list(dict.fromkeys(row["detector"] for row in [*self.cells, *self.timing]))
        return sorted(names, key=lambda name: not is_ours(name))

    def noises(self) -> list[float]:
        """Noise levels of the grid."""
        return sorted({row["noise"] for row in self.cells if row["sweep"] == GRID})

    def by_side(self, detector: str, noise: float) -> list[Row]:
        """A detector's rows of the grid at one noise level, by side."""
        rows = [r for r in self.cells if (r["sweep"], r["detector"], r["noise"]) == (GRID, detector, noise)]
        return sorted(rows, key=lambda row: float(row["side_px"]))

    def along(self, sweep: Sweep, detector: str) -> list[tuple[float, Row]]:
        """A detector's rows along a sweep, the base cell's among them where it fixes the factor."""
        rows = [row for row in self.cells if row["detector"] == detector]
        found = [(float(row[sweep.key]), row) for row in rows if row["sweep"] == sweep.name]
        if getattr(Cell(), sweep.key) is not None:
            found += [(float(row[sweep.key]), row) for row in rows if row["sweep"] == "base"]
        return sorted(found, key=lambda pair: pair[0])

    def empty_clutter(self, detector: str) -> Row | None:
        """A detector's row of the images in which there is no marker."""
        return next((r for r in self.cells if (r["sweep"], r["detector"]) == (EMPTY, detector)), None)

    def write(self, folder: Path) -> Path:
        """Write `bench.json`; OutputError if it cannot be."""
        content = {"environment": self.environment, "rows": self.cells, "timing": self.timing}
        return write_text(folder / RESULT, json.dumps(content, indent=1) + "\n")


def read_result(folder: Path) -> Result:
    """Read a run's `bench.json`; InputError if it is not there or not one."""
    path = folder / RESULT
    try:
        content = json.loads(path.read_text("utf-8"))
        return Result(content["environment"], content["rows"], content["timing"])
    except FileNotFoundError:
        raise InputError(str(folder), f"no {RESULT} in it", "the output folder of `skyherd bench`") from None
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(str(path), f"cannot be read: {error}", f"a {RESULT} of `skyherd bench`") from None


def environment(**asked: object) -> dict[str, Any]:
    """Programs and machine, and what was asked for."""
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
    """The processor's name, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or "not known"
