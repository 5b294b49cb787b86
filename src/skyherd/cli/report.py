"""`skyherd report`: make figures, summary and page again from a recording."""

from pathlib import Path
from typing import Annotated

import typer

from skyherd.cli.console import out, warn
from skyherd.errors import InputError
from skyherd.report.run_page import PAGE
from skyherd.runner import RECORDING, make_report


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Output folder of `skyherd run`.")],
) -> int:
    """Make figures, summary and page again from a run's recording, and its video if it has images."""
    if not (folder / RECORDING).is_file():
        raise InputError(str(folder), f"no {RECORDING} in it", "the output folder of `skyherd run`")
    summary = make_report(folder)
    if not summary["complete"]:
        warn(f"the run was cut short at {summary['simulated_s']:g} s of simulated time")
    out.print(f"see {folder / PAGE}", markup=False)
    return 0
