"""`skyherd report`: make figures, summary and page from the recording of a run, simulated or live."""

from pathlib import Path
from typing import Annotated

import typer

from skyherd.cli.console import say, warn
from skyherd.cli.run_folders import is_simulated_run
from skyherd.cli.view import write_replay
from skyherd.errors import InputError


def report(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="A folder of `skyherd run` or `skyherd live run`, such as runs/star."
        ),
    ],
    replay: Annotated[
        bool,
        typer.Option("--replay", help="Show the simulated run in 3-D on the page, from a file beside it."),
    ] = False,
    embed: Annotated[
        bool,
        typer.Option("--embed", help="Put videos and replay into the page, so that it can be sent alone."),
    ] = False,
) -> int:
    """Make figures, summary and page again from a recorded run.

    A simulated run has one recording, a live run one for each process. The video of a simulated run is made
    again, too, if the recording has images.
    """
    from skyherd.jobs.helpers import cores
    from skyherd.live.review import make_live_report
    from skyherd.report.run_page import PAGE, REPLAY
    from skyherd.runner import RECORDING, make_report

    is_simulated = is_simulated_run(folder, "report")
    for option, is_given in (("--replay", replay), ("--embed", embed)):
        if is_given and not is_simulated:
            raise InputError(option, f"{folder} is of a live run", "leave it out, or a simulated run")
    if replay:
        write_replay(folder / RECORDING, folder / REPLAY, force=True)
    summary = make_report(folder, embed=embed, jobs=cores()) if is_simulated else make_live_report(folder)
    if "recording" in summary:
        where = folder / RECORDING if is_simulated else folder
        warn(f"{where}: {summary['recording']}; the report shows the readable part")
    say(f"see {folder / PAGE}")
    return 0
