"""`skyherd detect`: find markers in pictures and videos, and say why others were not found."""

import os
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyherd.cli.choices import TABLE_FORMATS, complete_dictionary, complete_format
from skyherd.cli.console import ProgressReporter, complain_of, say, say_table, warn
from skyherd.cli.interrupts import NOTHING_LEFT, telling_of_interrupts
from skyherd.cli.keywords import with_options
from skyherd.cli.options import (
    BorderBits,
    Detector,
    ForceFolder,
    Inverted,
    MarkerSide,
    PoseCamera,
    Topic,
    metric_options,
)
from skyherd.cli.usage import only_known
from skyherd.errors import InputError

if TYPE_CHECKING:
    from skyherd.inspection import FileResult

SHOWN_IDS = 16
"""Ids listed of one file before an ellipsis. Chosen: they fit on a line of 80 characters."""

SHOWN_REJECTIONS, SHOWN_OF_REASON = 20, 4
"""Rejected candidates listed of one picture, and of one reason; the rest are counted. Chosen: a screen's
height, and a few that differ in their numbers."""


def detect(
    target: Annotated[
        Path,
        typer.Argument(
            metavar="IMAGE|DIR|VIDEO|BAG",
            help="A picture, a folder, a video, or a rosbag2 recording, such as photo.jpg.",
        ),
    ],
    dictionary: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Dictionary of the markers, such as APRILTAG_36h11 or DICT_4X4_50; auto finds that of each "
            "file. `skyherd markers --help` lists them.",
            autocompletion=complete_dictionary,
        ),
    ] = "4X4_50",
    detector: Detector = "photometric",
    out_dir: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            show_default="detections/NAME",
            help="Write the results into this new folder.",
        ),
    ] = None,
    kind: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="FORMAT",
            help=f"Format of the table: {' or '.join(TABLE_FORMATS)}.",
            autocompletion=complete_format,
            callback=only_known(TABLE_FORMATS),
        ),
    ] = "csv",
    marker_side_m: MarkerSide = None,
    camera: PoseCamera = None,
    one_plane: Annotated[
        bool, typer.Option("--one-plane", help="All markers lie on one plane; makes poses more accurate.")
    ] = False,
    topic: Topic = None,
    border_bits: BorderBits = 1,
    inverted: Inverted = False,
    repeats: Annotated[
        bool, typer.Option("--repeats", help="Report an id that is found twice at each of its places.")
    ] = False,
    explained: Annotated[
        bool,
        typer.Option("--explain", help="Explain why each candidate was rejected, and what would help."),
    ] = False,
    require: Annotated[
        bool, typer.Option("--require", help="Exit with code 1 if a file shows no marker.")
    ] = False,
    force: ForceFolder = False,
) -> int:
    """Find markers in pictures and videos; explain what is missed.

    Exit code 0 when done, 1 with --require if a file has none, 2 for bad input.
    """
    from skyherd.files.rosbag_reader import is_bag
    from skyherd.inspection import AUTO, DETECTIONS, Inspector, output_name

    if one_plane and camera is None:
        raise InputError("--one-plane", "given without --camera", "a calibration")
    side_m, calibration = metric_options(marker_side_m, camera)
    if target.suffix in (".toml", ".mcap") and not is_bag(target):
        from skyherd.datasets import refuse_configuration

        refuse_configuration(target, "picture or video")
    folder = out_dir or Path("detections") / output_name(Path(os.path.abspath(target)).stem)
    with ProgressReporter() as progress:
        inspector = Inspector(
            detector,
            dictionary,
            border_bits=border_bits,
            inverted=inverted,
            repeats=repeats,
            explained=explained,
            side_m=side_m,
            calibration=calibration,
            one_plane=one_plane,
            topic=topic,
            kind="jsonl" if kind == "jsonl" else "csv",
            progress=progress,
        )
        with telling_of_interrupts(NOTHING_LEFT):
            results = inspector.inspect(target, folder, force=force)
    _say_results(results)
    if dictionary == AUTO:
        for result in results:
            if result.ids:
                say(f"{result.file.name}: its markers are of {result.dictionary}")
    say(f"see {folder / DETECTIONS}.{kind}  {_pictures(results, folder)}")
    if any(result.trouble for result in results):
        return 2
    return 1 if require and not all(result.ids for result in results) else 0


def _say_results(results: list["FileResult"]) -> None:
    """Print a line a file, what to try where nothing was found, and why candidates were rejected."""
    rows = []
    for result in results:
        if result.trouble is None:
            ids = sorted(result.ids)
            shown = ", ".join(map(str, ids[:SHOWN_IDS])) + (" …" if len(ids) > SHOWN_IDS else "")
            frames, markers = str(result.frames), str(sum(result.ids.values()))
            rows.append((result.file.name, frames, markers, shown or "–"))
    say_table(("file", "frames", "markers", "ids"), rows, right_aligned=("frames", "markers"))
    for result in results:
        if result.trouble is not None:
            complain_of(result.trouble)
        elif result.hint or not result.ids:
            found = f"only {sum(result.ids.values())} marker(s) found" if result.ids else "no marker found"
            warn(f"{result.file}: {found}" + (f": {result.hint}" if result.hint else ""))
    for result in results:
        _say_rejections(result)


def _say_rejections(result: "FileResult") -> None:
    """Print why candidates were rejected: of a picture each one, of a video how many for each reason."""
    from skyherd.vision import Reason

    if not result.reasons:
        return
    if result.frames > 1:
        counts = ", ".join(f"{count} x {reason}" for reason, count in result.reasons.most_common())
        say(f"{result.file.name}: not detected, over all frames: {counts}")
        return
    likely = [r for r in result.rejections if r.reason is not Reason.NO_BITS]
    say(f"{result.file.name}: not detected:")
    shown, rest = Counter[str](), Counter[str]()
    for number, rejection in enumerate(likely, start=1):
        reason = rejection.reason.value
        if shown[reason] == SHOWN_OF_REASON or shown.total() == SHOWN_REJECTIONS:
            rest[reason] += 1
            continue
        shown[reason] += 1
        u, v = rejection.center_px
        say(f"  {number}. at ({u:.0f}, {v:.0f}): {reason}: {with_options(rejection.words)}")
    if plain := len(result.rejections) - len(likely):
        rest["dark quadrilateral without bits"] = plain
    if rest:
        say(f"  and {', '.join(f'{count} x {reason}' for reason, count in rest.items())}")


def _pictures(results: list["FileResult"], folder: Path) -> str:
    """Return the annotated file, or the number of files."""
    pictures = [result.picture for result in results if result.picture is not None]
    return str(pictures[0]) if len(pictures) == 1 else f"and {len(pictures)} annotated files in {folder}"
