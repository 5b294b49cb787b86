"""`skyherd bench`: measure detectors on drawings, photographs and boards."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyherd.cli.choices import DETECTORS, complete_dictionary
from skyherd.cli.console import ProgressReporter, say, say_table, warn
from skyherd.cli.interrupts import NOTHING_LEFT, telling_of_interrupts
from skyherd.cli.options import Jobs
from skyherd.errors import InputError

if TYPE_CHECKING:
    from skyherd.bench.set_result import SetResult
    from skyherd.bench.table import Table

bench_app = typer.Typer(help="Measure detectors on drawings, photographs and boards.", rich_markup_mode=None)

FULL_FRAMES, FULL_BUDGET_S = 300, 5.0
QUICK_FRAMES, QUICK_BUDGET_S = 20, 0.4
MAX_SEED = 2**63
"""Seeds are below this. Chosen: what 64 bits with a sign hold, so that every format can keep it."""

QUICK_SIZES_PX = ((640, 480), (1280, 960))


Force = Annotated[bool, typer.Option("--force", help="Replace the results of an earlier call.")]

Names = Annotated[
    str | None,
    typer.Option(
        "--detectors",
        "--detector",
        metavar="NAMES",
        help=f"Measure only these, with commas between: {', '.join(DETECTORS)}, or module:factory.",
    ),
]


@bench_app.callback()
def _bench() -> None:
    """Measure detectors on drawings, photographs and boards."""


@bench_app.command()
def detectors(
    quick: Annotated[
        bool, typer.Option("--quick", help="Measure few cells and frames, in about a minute.")
    ] = False,
    out_dir: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Write the results into this folder.")
    ] = Path("runs/bench"),
    names: Names = None,
    dictionary: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Dictionary of the markers. Detectors that do not know it use APRILTAG_36h11.",
            autocompletion=complete_dictionary,
        ),
    ] = "4X4_50",
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of all frames.")] = 1,
    jobs: Jobs = None,
    clutter_images: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=0, help="Search this many images without a marker for false positives."
        ),
    ] = None,
    uncorrected: Annotated[
        bool,
        typer.Option(
            "--uncorrected",
            help="Do not correct the constant biases and the corner order of other libraries.",
        ),
    ] = False,
    force: Force = False,
) -> int:
    """Compare marker detectors on drawn frames with the Cramér–Rao bound.

    It writes bench.json, bench.html, bench.md and figures.
    """
    from skyherd.bench.detectors.design import full_design, quick_design
    from skyherd.bench.detectors.page import output_names, write_outputs
    from skyherd.bench.detectors.timing import measure_times, timing_cells
    from skyherd.bench.entrants import default_entrants, missing_libraries
    from skyherd.bench.execution import Plan, measure_cells
    from skyherd.bench.result import Result, environment
    from skyherd.files.output_folder import OutputFolder

    chosen = _split(names) or default_entrants()
    _check(chosen, seed)
    if names is None and (missing := missing_libraries()):
        warn(f"{', '.join(missing)} left out: pip install skyherd[peers]")
    images = {} if clutter_images is None else {"clutter_images": clutter_images}
    cells = quick_design(**images) if quick else full_design(**images)
    timed = timing_cells(QUICK_FRAMES, QUICK_SIZES_PX) if quick else timing_cells(FULL_FRAMES)
    plan = Plan(tuple(chosen), dictionary, seed, corrected=not uncorrected)
    with (
        telling_of_interrupts(NOTHING_LEFT),
        OutputFolder(out_dir, "bench detectors", output_names(), force=force) as output,
    ):
        with ProgressReporter() as progress:
            rows = measure_cells(plan, cells, jobs=jobs or os.cpu_count() or 1, progress=progress)
            times = measure_times(plan, timed, QUICK_BUDGET_S if quick else FULL_BUDGET_S, progress=progress)
        measured_on = environment(quick=quick, dictionary=dictionary, seed=seed, corrected=not uncorrected)
        result = Result(measured_on, rows, times)
        result.write(out_dir)
        output.keep()
        page = write_outputs(result, out_dir)
    say(f"see {page}")
    return 0


Folder = Annotated[
    Path, typer.Argument(metavar="DIR", help="Folder of the photographs, such as pictures/desk.")
]
SetsFile = Annotated[
    Path | None,
    typer.Option(
        "--sets", metavar="FILE", show_default="photographs.toml in the folder", help="File of the sets."
    ),
]
Only = Annotated[
    str | None, typer.Option("--only", metavar="NAMES", help="Measure only these sets, with commas between.")
]


@bench_app.command()
def photographs(
    folder: Folder,
    sets_file: SetsFile = None,
    names: Names = None,
    only: Only = None,
    out_dir: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Write the results into this folder.")
    ] = Path("runs/photographs"),
    force: Force = False,
) -> int:
    """Count which markers detectors find on photographs.

    A marker counts if two detectors confirm it. The file of the sets names the photographs and their
    markers. The guide "Test detectors on photographs" has its keys. It writes photographs.json,
    photographs.html, missed.csv, unconfirmed.csv and pictures.
    """
    from skyherd.bench.image_sets import load_image_sets, read_files
    from skyherd.bench.photographs.measurement import measure_photographs
    from skyherd.bench.photographs.page import output_names, write_outputs
    from skyherd.bench.photographs.result import PhotographsResult
    from skyherd.bench.photographs.tables import set_tables
    from skyherd.bench.result import environment
    from skyherd.files.output_folder import OutputFolder

    chosen, judges = _chosen_and_judges(names)
    image_sets = load_image_sets(folder, sets_file, only=tuple(_split(only)))
    names_left, inputs = output_names(chosen), read_files(image_sets, folder, sets_file)
    with (
        telling_of_interrupts(NOTHING_LEFT),
        OutputFolder(out_dir, "bench photographs", names_left, force=force, inputs=inputs),
    ):
        with ProgressReporter() as progress:
            measured = measure_photographs(image_sets, chosen, judges, progress=progress)
        result = PhotographsResult(environment(confirmed_by=judges), measured.rows, measured.refused)
        result.write_all(out_dir, measured.missed, measured.unconfirmed)
        _say_result(result, set_tables(result))
        page = write_outputs(result, measured, out_dir)
    say(f"see {page}")
    return 0


@bench_app.command()
def boards(
    folder: Folder,
    sets_file: SetsFile = None,
    names: Names = None,
    only: Only = None,
    out_dir: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Write the results into this folder.")
    ] = Path("runs/boards"),
    force: Force = False,
) -> int:
    """Measure the accuracy of detectors on photographs of boards.

    Each marker is predicted from the others of its calibration board. Sets need a table `board`, which the
    guide "Measure accuracy on boards" describes. It writes boards.json,
    boards.html, boards.md and figures.
    """
    from skyherd.bench.boards.measurement import measure_boards
    from skyherd.bench.boards.page import OUTPUT_NAMES, write_outputs
    from skyherd.bench.boards.tables import set_tables
    from skyherd.bench.image_sets import load_image_sets, read_files
    from skyherd.bench.result import environment
    from skyherd.bench.set_result import SetResult
    from skyherd.files.output_folder import OutputFolder

    chosen, judges = _chosen_and_judges(names)
    image_sets = load_image_sets(folder, sets_file, only=tuple(_split(only)))
    inputs = read_files(image_sets, folder, sets_file)
    with (
        telling_of_interrupts(NOTHING_LEFT),
        OutputFolder(out_dir, "bench boards", OUTPUT_NAMES, force=force, inputs=inputs),
    ):
        with ProgressReporter() as progress:
            measured = measure_boards(image_sets, chosen, judges, progress=progress)
        result = SetResult(environment(confirmed_by=judges), measured.rows, measured.refused)
        _say_result(result, set_tables(result))
        page = write_outputs(result, measured, out_dir)
    say(f"see {page}")
    return 0


def _chosen_and_judges(names: str | None) -> tuple[list[str], list[str]]:
    """Return the reported detectors, and those that confirm markers.

    Raises:
        InputError: a detector is named twice.
    """
    from skyherd.bench.entrants import default_entrants, missing_libraries
    from skyherd.bench.photographs.measurement import JUDGES

    chosen = _split(names) or [name for name in default_entrants() if name != "tracking"]
    _check(chosen)
    if missing := missing_libraries():
        warn(f"{', '.join(missing)} cannot confirm any marker: pip install skyherd[peers]")
    return chosen, [name for name in JUDGES if name not in missing]


def _say_result(result: "SetResult", tables: "list[Table]") -> None:
    """Print the tables of the sets, and the sets that no detector can read."""
    for table in tables:
        say(table.title, bold=True)
        say_table(table.header, table.rows, right_aligned=table.header[1:])
    for name, why in result.unread().items():
        warn(f"no detector can read {name}: {why}")


def _split(names: str | None) -> list[str]:
    """Return the names between commas."""
    return [name.strip() for name in (names or "").split(",") if name.strip()]


def _check(chosen: list[str], seed: int = 0) -> None:
    """Check the options.

    Raises:
        InputError: a detector is named twice, or the seed is out of range.
    """
    if repeated := sorted({name for name in chosen if chosen.count(name) > 1}):
        raise InputError("--detectors", f"{', '.join(repeated)} named twice", "each detector once")
    if not 0 <= seed < MAX_SEED:
        raise InputError("--seed", str(seed), "0 or more, and below 2 to the power of 63")
