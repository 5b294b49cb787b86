"""Export of a run into a folder."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from skyherd.errors import InputError
from skyherd.files.atomic import write_text
from skyherd.files.output_folder import OutputFolder
from skyherd.jobs.progress import NO_PROGRESS, Progress
from skyherd.recording.export.coco import ANNOTATIONS, IMAGES, write_coco
from skyherd.recording.export.recorded_run import RecordedRun
from skyherd.recording.export.rosbag import BAG, METADATA, require_rosbags, write_rosbag
from skyherd.recording.export.table_files import open_csv, parquet_opener, write_tables
from skyherd.recording.export.tables import tables_of
from skyherd.text import one_of
from skyherd.version import __version__

Format = Literal["csv", "parquet", "rosbag2", "coco"]
FORMATS: tuple[Format, ...] = get_args(Format)
"""Formats of an export."""

VERB = "export"
"""Verb in the record of output folders for the files made here."""

ABOUT = "about.json"
"""Description of the run and of the tables; written last."""


@dataclass(frozen=True)
class Exported:
    """Result of an export.

    Attributes:
        file: the main file.
        counts: number of rows, messages or entries, by table, type or kind.
        flaws: defects of the recording, a short text each.
    """

    file: Path
    counts: dict[str, int]
    flaws: list[str]


def check_format(kind: str) -> Format:
    """Return a format by its name.

    Raises:
        InputError: there is no such format, or the library that writes it is not installed.
    """
    for known in FORMATS:
        if kind == known:
            if known == "rosbag2":
                require_rosbags()
            elif known == "parquet":
                parquet_opener()
            return known
    raise InputError("kind", f"no format {kind!r}", one_of(kind, FORMATS))


def export_run(
    run: RecordedRun,
    folder: Path,
    kind: Format,
    *,
    force: bool = False,
    progress: Progress = NO_PROGRESS,
) -> Exported:
    """Export a run into a folder. A failed export leaves nothing.

    Args:
        run: the run.
        folder: the output folder; for rosbag2 it is the bag.
        kind: the format.
        force: accept an existing folder. Only files of an earlier export are replaced.
        progress: receives the time in the run.

    Raises:
        InputError: the folder exists, or a library is missing.
        OutputError: a file cannot be written.
    """
    names, write = _plan(run, kind)
    with OutputFolder(folder, VERB, [*names, ABOUT], force=force):
        counts = write(run, folder, progress)
        write_text(folder / ABOUT, _about(run, kind, counts))
    return Exported(folder / names[0], counts, run.flaws)


def _plan(
    run: RecordedRun, kind: Format
) -> tuple[list[str], Callable[[RecordedRun, Path, Progress], dict[str, int]]]:
    """Return the files of a format, the main one first, and the function that writes them."""
    if kind == "coco":
        return [ANNOTATIONS, f"{IMAGES}/"], write_coco
    if kind == "rosbag2":
        require_rosbags()
        return [METADATA, BAG], write_rosbag
    opener = open_csv if kind == "csv" else parquet_opener()
    names = sorted((f"{spec.name}.{kind}" for spec in tables_of(run.kind)), key=_detections_first)
    return names, lambda run, folder, progress: write_tables(run, folder, f".{kind}", opener, progress)


def _detections_first(name: str) -> bool:
    return not name.startswith("detections.")


def _about(run: RecordedRun, kind: Format, counts: dict[str, int]) -> str:
    """Return the description of an export as JSON."""
    about = {
        "skyherd": __version__,
        "format": kind,
        "run": run.name,
        "kind": run.kind,
        "recorded_by": run.versions,
        "start_unix_s": run.start_unix_s,
        "end_s": run.end_s,
        "flaws": run.flaws,
        "counts": counts,
        "configuration": run.configuration,
    }
    if kind in ("csv", "parquet"):
        about["tables"] = {
            spec.name: {"row": spec.row, "columns": spec.meanings} for spec in tables_of(run.kind)
        }
    return json.dumps(about, indent=1) + "\n"
