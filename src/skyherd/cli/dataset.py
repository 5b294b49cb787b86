"""`skyherd dataset`: make labelled image sets, check them, and show the specs they are made from."""

import json
import os
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from skyherd.cli.console import ProgressReporter, complain, out
from skyherd.datasets import (
    DatasetSpec,
    Verdict,
    check_dataset,
    load_spec,
    make_dataset,
    spec_names,
    spec_text,
)
from skyherd.errors import InputError

dataset_app = typer.Typer(help="Make labelled image sets, and check them.", rich_markup_mode=None)


@dataset_app.command()
def make(
    spec: Annotated[str, typer.Argument(metavar="SPEC", help="A TOML file or a built-in spec.")],
    out_dir: Annotated[Path | None, typer.Option("--out", help="Folder; labelled/NAME if left out.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes; one a core if left out.")] = None,
    seed: Annotated[int | None, typer.Option(help="Put over the spec's.")] = None,
    images: Annotated[int | None, typer.Option(help="Number of images, put over the spec's.")] = None,
) -> int:
    """Make a labelled image set, or go on with one that was interrupted: COCO, YOLO-pose, tables, preview."""
    if jobs is not None and jobs < 1:
        raise InputError("--jobs", str(jobs), "1 or more")
    file = load_spec(spec, seed=seed, images=images)
    folder = out_dir or Path("labelled") / Path(spec).stem
    try:
        with ProgressReporter() as progress:
            dataset = make_dataset(file, folder, jobs=jobs or os.cpu_count() or 1, progress=progress)
    except KeyboardInterrupt:
        complain("interrupted; images that are there are whole, and the same command goes on from here")
        return 130
    out.print(
        f"{folder}: {len(dataset)} images, {dataset.markers} markers; see {folder / 'preview.png'}",
        markup=False,
    )
    return 0


@dataset_app.command()
def check(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="What `make` left.")],
    sample: Annotated[int, typer.Option(help="Images drawn again, and looked at by the detector.")] = 24,
) -> int:
    """Check a set: exit code 0 if all is well, 1 for problems, a line each, 2 if it is no data set."""
    if sample < 0:
        raise InputError("--sample", str(sample), "0 or more")
    verdict = check_dataset(folder, sample=sample)
    for problem in verdict.problems:
        complain(problem)
    _tell(folder, verdict)
    return 1 if verdict.problems else 0


@dataset_app.command("list")
def list_specs() -> None:
    """List the built-in specs."""
    table = Table(box=None, header_style="bold")
    for column in ("name", "images", "size", "what it is for"):
        table.add_column(column)
    for name in spec_names():
        spec = load_spec(name).spec
        table.add_row(name, str(spec.images), "{}x{}".format(*spec.size_px), spec.description)
    out.print(table)


@dataset_app.command()
def show(name: Annotated[str, typer.Argument(help="A built-in spec.")]) -> None:
    """Print a built-in spec, to be saved and changed."""
    typer.echo(spec_text(name), nl=False)


@dataset_app.command()
def schema() -> None:
    """Print the JSON schema of specs."""
    typer.echo(json.dumps(DatasetSpec.model_json_schema(), indent=2))


def _tell(folder: Path, verdict: Verdict) -> None:
    problems = len(verdict.problems)
    state = f"{problems} problem{'s' * (problems != 1)}" if problems else "good"
    out.print(f"{folder}: {state}: {verdict.images} images, {verdict.markers} markers", markup=False)
    if (found := verdict.agreement) and found.found:
        out.print(
            f"detected in {found.images} images: {found.found} of {found.clear} whole markers from 20 px "
            f"({found.recall:.1%}), RMS error {found.rmse_px:.4f} px and {found.rmse_deg:.3f} deg",
            markup=False,
        )
