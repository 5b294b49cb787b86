"""`skyherd detect`: find markers in pictures and videos, and say why others were not found."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from skyherd.cli.console import ProgressReporter, complain, out, warn
from skyherd.errors import InputError
from skyherd.inspection import DETECTIONS, FORMATS, FileResult, Inspector
from skyherd.vision import Reason, detector_names

SHOWN_IDS = 16
SHOWN_REJECTIONS = 20


def detect(
    target: Annotated[Path, typer.Argument(metavar="IMAGE|DIR|VIDEO", help="What to look at.")],
    dictionary: Annotated[str, typer.Option(help="Marker dictionary, such as APRILTAG_36h11.")] = "4X4_50",
    detector: Annotated[str, typer.Option(help=f"One of {', '.join(detector_names())}.")] = "photometric",
    out_dir: Annotated[
        Path | None, typer.Option("--out", help="Folder to make; detections/NAME if left out.")
    ] = None,
    kind: Annotated[str, typer.Option("--format", help="Of the table: csv or jsonl.")] = "csv",
    explained: Annotated[
        bool, typer.Option("--explain", help="Say for every rejected candidate why, and what would help.")
    ] = False,
    require: Annotated[
        bool, typer.Option("--require", help="Exit code 1 if there is a file without any marker.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Write into an existing folder.")] = False,
) -> int:
    """Find markers; exit code 0 when done, 1 with --require if a file has none, 2 for bad input."""
    if kind not in FORMATS:
        raise InputError("--format", f"no format {kind!r}", f"one of {', '.join(FORMATS)}")
    folder = out_dir or Path("detections") / (target.resolve().stem or "root")
    with ProgressReporter() as progress:
        inspector = Inspector(
            detector,
            dictionary,
            explained=explained,
            kind="jsonl" if kind == "jsonl" else "csv",
            progress=progress,
        )
        try:
            results = inspector.inspect(target, folder, force=force)
        except KeyboardInterrupt:
            complain("interrupted; annotated files that are there are whole, the table was not written")
            return 130
    _tell(results)
    for result in results:
        _tell_rejections(result)
    out.print(f"see {folder / DETECTIONS}.{kind}  {_pictures(results, folder)}", markup=False)
    if any(result.trouble for result in results):
        return 2
    return 1 if require and not all(result.ids for result in results) else 0


def _tell(results: list[FileResult]) -> None:
    """A line a file, and what to try where nothing was found."""
    table = Table(box=None, header_style="bold")
    for column, side in (("file", "left"), ("frames", "right"), ("markers", "right"), ("ids", "left")):
        table.add_column(column, justify="right" if side == "right" else "left")
    for result in results:
        if result.trouble is not None:
            continue
        ids = sorted(result.ids)
        shown = ", ".join(map(str, ids[:SHOWN_IDS])) + (" …" if len(ids) > SHOWN_IDS else "")
        table.add_row(result.file.name, str(result.frames), str(sum(result.ids.values())), shown or "–")
    if table.row_count:
        out.print(table)
    for result in results:
        if result.trouble is not None:
            complain(str(result.trouble))
        elif result.hint or not result.ids:
            found = f"only {sum(result.ids.values())} marker(s) found" if result.ids else "no marker found"
            warn(f"{result.file}: {found}" + (f": {result.hint}" if result.hint else ""))


def _tell_rejections(result: FileResult) -> None:
    """Why candidates were rejected: of a picture each one, of a video how many for each reason."""
    if not result.reasons:
        return
    if result.frames > 1:
        counts = ", ".join(f"{count} x {reason}" for reason, count in result.reasons.most_common())
        out.print(f"{result.file.name}: not detected, over all frames: {counts}", markup=False)
        return
    likely = [r for r in result.rejections if r.reason is not Reason.NO_BITS]
    out.print(f"{result.file.name}: not detected:", markup=False)
    for number, rejection in enumerate(likely[:SHOWN_REJECTIONS], start=1):
        u, v = rejection.center_px
        out.print(
            f"  {number}. at ({u:.0f}, {v:.0f}): {rejection.reason.value}: {rejection.words}", markup=False
        )
    rest = [
        f"{count} more {what}"
        for count, what in (
            (len(likely) - SHOWN_REJECTIONS, "in the table"),
            (len(result.rejections) - len(likely), "dark quadrilateral(s) without bits"),
        )
        if count > 0
    ]
    if rest:
        out.print(f"  and {', '.join(rest)}", markup=False)


def _pictures(results: list[FileResult], folder: Path) -> str:
    """The annotated file, or how many there are."""
    pictures = [result.picture for result in results if result.picture is not None]
    return str(pictures[0]) if len(pictures) == 1 else f"and {len(pictures)} annotated files in {folder}"
