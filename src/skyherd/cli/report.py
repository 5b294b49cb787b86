"""`skyherd report`: make figures, summary and page from the recording of a run, simulated or live."""

import os
from pathlib import Path
from typing import Annotated

import typer

from skyherd.cli.console import say, warn
from skyherd.errors import InputError


def report(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="A folder of `skyherd run` or `skyherd live run`.")
    ],
) -> int:
    """Make figures, summary and page again from a recorded run.

    A simulated run has one recording, a live run one for each process. The video of a simulated run is made
    again, too, if the recording has images.
    """
    from skyherd.datasets import refuse_configuration
    from skyherd.jobs.helpers import cores
    from skyherd.live.review import make_live_report, recorded_files
    from skyherd.report.run_page import PAGE
    from skyherd.runner import RECORDING, make_report

    is_simulated = os.path.lexists(folder / RECORDING)
    allowed = "the output folder of `skyherd run` or `skyherd live run`"
    if not os.path.isdir(folder):
        if folder.name == RECORDING and os.path.isdir(folder.parent):
            raise InputError(
                str(folder), "is a recording", f"give its folder: `skyherd report {folder.parent}`"
            )
        refuse_configuration(folder, "run")
        what = "is a file" if os.path.lexists(folder) else "no such folder"
        raise InputError(str(folder), what, allowed)
    if not is_simulated and not recorded_files(folder):
        what = f"no {RECORDING} in it, and no recordings of units or robots"
        raise InputError(str(folder), what, allowed)
    summary = make_report(folder, jobs=cores()) if is_simulated else make_live_report(folder)
    if "recording" in summary:
        where = folder / RECORDING if is_simulated else folder
        warn(f"{where}: {summary['recording']}; the report shows the readable part")
    say(f"see {folder / PAGE}")
    return 0
