"""Two small studies, and a study that runs in this process."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from skyherd.cli import main
from skyherd.study import conduct as conducting
from skyherd.study.conduct import StudyReport, conduct
from skyherd.study.measure import measure
from skyherd.study.plan import make_plan
from skyherd.study.spec import load_study
from skyherd.study.table import read_table

SMALL = """
description = "Gains and cameras."
scenario = "triangle"
keep = ["shape_error", "V_end", "converged"]

[set]
perception = "ideal"
duration_s = 0.4

[grid]
control.k = [0.1, 0.3]
units.0.yaw_deg = [0, 90, 180]

[quick.grid]
control.k = [0.1]
"""

SLOW_ENOUGH = """
scenario = "triangle"
keep = ["shape_error", "path_length_m"]
set = { perception = "noisy", duration_s = 6.0 }
random = { runs = 10, seed = 5, draw = { "units.0.yaw_deg" = [-180, 180], seed = { whole = [1, 1000] } } }
"""
"""A study of ten runs of some tenths of a second with different noise: slow enough to be killed midway."""


def run_in_process(patch: pytest.MonkeyPatch) -> None:
    """Make runs in this process, one at a time, instead of on a cluster."""

    def run(client: Any, missions: Any, curves: Any) -> Iterator[list[dict[str, Any]]]:
        for key, mission in missions:
            yield [measure(key, mission, curves)]

    patch.setattr(conducting, "open_client", lambda scheduler, jobs: contextlib.nullcontext())
    patch.setattr(conducting, "run_missions", run)


def conduct_here(path: Path, folder: Path, **options: Any) -> tuple[pa.Table, StudyReport]:
    report = conduct(make_plan(load_study(str(path))), folder, **options)
    return read_table(folder), report


def call(capsys: Any, *arguments: Any) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    said = capsys.readouterr()
    return int(ended.value.code or 0), said.out, said.err
