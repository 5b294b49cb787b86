"""`skyherd dataset`: make labelled image sets, check them, and show the specs they are made from."""

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyherd.cli.choices import complete_spec
from skyherd.cli.console import ProgressReporter, complain, say, say_table
from skyherd.cli.interrupts import telling_of_interrupts
from skyherd.cli.options import Jobs

if TYPE_CHECKING:
    from skyherd.datasets.labelled.check import Verdict

dataset_app = typer.Typer(help="Make labelled image sets, and check them.", rich_markup_mode=None)


@dataset_app.command()
def make(
    spec: Annotated[
        str,
        typer.Argument(
            metavar="SPEC",
            help="A built-in spec, such as small, or a TOML file.",
            autocompletion=complete_spec,
        ),
    ],
    out_dir: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", show_default="labelled/NAME", help="Write the set into this folder."
        ),
    ] = None,
    jobs: Jobs = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="Replace the spec's seed of all random draws.")
    ] = None,
    images: Annotated[
        int | None, typer.Option(metavar="N", help="Replace the spec's number of images.")
    ] = None,
) -> int:
    """Make a labelled image set from a spec.

    The same command continues a set that was interrupted. It writes COCO and YOLO-pose labels, tables of the
    exact truth, and a preview.
    """
    from skyherd.datasets.labelled.make import make_dataset
    from skyherd.datasets.labelled.spec import load_spec

    file = load_spec(spec, seed=seed, images=images)
    folder = out_dir or Path("labelled") / Path(spec).stem
    with (
        telling_of_interrupts("finished images are kept, and the same command continues from here"),
        ProgressReporter() as progress,
    ):
        dataset = make_dataset(file, folder, jobs=jobs or os.cpu_count() or 1, progress=progress)
    say(f"{folder}: {len(dataset)} images, {dataset.markers} markers; see {folder / 'preview.png'}")
    return 0


@dataset_app.command()
def check(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="The folder of a set of `skyherd dataset make`, such as labelled/small."
        ),
    ],
    sample: Annotated[
        int,
        typer.Option(metavar="N", min=0, help="Draw this many images again, and run the detector on them."),
    ] = 24,
) -> int:
    """Check a labelled image set against its truth and its seed.

    Exit code 0 if there is no problem, 1 for problems, which have a line each, 2 if it is not a data set.
    """
    from skyherd.datasets import refuse_configuration
    from skyherd.datasets.labelled.check import check_dataset

    refuse_configuration(folder, "data set")
    verdict = check_dataset(folder, sample=sample)
    for problem in verdict.problems:
        complain(problem)
    _say_verdict(folder, verdict)
    return 1 if verdict.problems else 0


@dataset_app.command("list")
def list_specs() -> None:
    """List the built-in specs."""
    from skyherd.datasets.labelled.spec import load_spec, spec_names

    rows = []
    for name in spec_names():
        spec = load_spec(name).spec
        rows.append((name, str(spec.images), "{}x{}".format(*spec.size_px), spec.description))
    say_table(("name", "images", "size", "what it is for"), rows)


@dataset_app.command()
def show(
    name: Annotated[
        str,
        typer.Argument(metavar="NAME", help="A built-in spec, such as small.", autocompletion=complete_spec),
    ],
) -> None:
    """Print a built-in spec, to save and change."""
    from skyherd.datasets.labelled.spec import spec_text

    typer.echo(spec_text(name), nl=False)


@dataset_app.command()
def schema() -> None:
    """Print the JSON schema of specs."""
    from skyherd.datasets.labelled.spec import DatasetSpec

    typer.echo(json.dumps(DatasetSpec.model_json_schema(), indent=2))


def _say_verdict(folder: Path, verdict: "Verdict") -> None:
    problems = len(verdict.problems)
    state = f"{problems} problem{'s' * (problems != 1)}" if problems else "good"
    say(f"{folder}: {state}: {verdict.images} images, {verdict.markers} markers")
    if (found := verdict.agreement) and found.found:
        say(
            f"detected in {found.images} images: {found.found} of {found.clear} whole markers from 20 px "
            f"({found.recall:.1%}), RMS error {found.rmse_px:.4f} px and {found.rmse_deg:.3f} deg"
        )
