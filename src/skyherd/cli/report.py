"""`skyherd report`: make figures, summary and page again from a recording."""

import os
from pathlib import Path
from typing import Annotated

import typer

from skyherd.cli.console import say, warn
from skyherd.errors import InputError


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Output folder of `skyherd run`.")],
) -> int:
    """Make figures, summary and page again from a run's recording.

    The video is made again too if the recording has images.
    """
    from skyherd.report.run_page import PAGE
    from skyherd.runner import RECORDING, make_report

    if not os.path.lexists(folder / RECORDING):
        raise InputError(str(folder), f"no {RECORDING} in it", "the output folder of `skyherd run`")
    summary = make_report(folder)
    if "recording" in summary:
        warn(f"{folder / RECORDING}: {summary['recording']}; the report is of what can be read")
    say(f"see {folder / PAGE}")
    return 0
