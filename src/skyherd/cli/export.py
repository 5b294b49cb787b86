"""`skyherd export`: write the content of a recorded run in formats of other programs."""

import os
from pathlib import Path
from typing import Annotated

import typer

from skyherd.cli.choices import EXPORT_FORMATS, complete_export_format
from skyherd.cli.console import ProgressReporter, say, say_table, warn
from skyherd.cli.interrupts import NOTHING_LEFT, telling_of_interrupts
from skyherd.cli.options import ForceFolder
from skyherd.cli.run_folders import is_simulated_run


def export(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="RUN", help="A folder of `skyherd run` or `skyherd live run`, such as runs/star."
        ),
    ],
    kind: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="FORMAT",
            help=f"Format: {', '.join(EXPORT_FORMATS)}.",
            autocompletion=complete_export_format,
        ),
    ] = "csv",
    out_dir: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            show_default="exports/NAME-FORMAT",
            help="Write the results into this new folder.",
        ),
    ] = None,
    force: ForceFolder = False,
) -> int:
    """Export what was seen and decided in a recorded run.

    csv and parquet have a table for each kind of record, rosbag2 a topic, and coco the detections with the
    recorded images.
    """
    from skyherd.files.output_folder import OutputFolder
    from skyherd.inspection import output_name
    from skyherd.live.review import read_live_run
    from skyherd.recording.export import export_run, read_simulated
    from skyherd.recording.export.job import check_format
    from skyherd.runner import RECORDING

    known = check_format(kind)
    simulated = is_simulated_run(folder, "export")
    name = Path(os.path.abspath(folder)).name
    target = out_dir or Path("exports") / output_name(f"{name}-{known}")
    OutputFolder(target, "export", [], force=force).check()
    with ProgressReporter() as progress, telling_of_interrupts(NOTHING_LEFT):
        run = read_simulated(folder / RECORDING, name) if simulated else read_live_run(folder, progress)
        exported = export_run(run, target, known, force=force, progress=progress)
    say_table(
        ("content", "count"),
        [(key, str(count)) for key, count in exported.counts.items()],
        right_aligned=("count",),
    )
    if exported.flaws:
        warn(f"{folder}: {'; '.join(exported.flaws)}; the export has the readable part")
    if known == "coco" and not exported.counts["pictures"]:
        hint = "`skyherd run --record-images` keeps them" if simulated else "a live run keeps only previews"
        warn(f"{folder}: no images are recorded; {hint}")
    say(f"see {exported.file}")
    return 0
