"""`skyherd study`: run a scenario many times, on all cores or a cluster, and keep the outcomes in a table."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyherd.cli.choices import complete_study
from skyherd.cli.console import ProgressReporter, say
from skyherd.cli.interrupts import telling_of_interrupts
from skyherd.cli.options import Jobs
from skyherd.errors import InputError

if TYPE_CHECKING:
    from skyherd.study.plan import Plan

EXTRA = ("dask", "distributed", "pyarrow", "cryptography")
"""Modules that the extra `study` installs."""


def study(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME|FILE",
            help="A built-in study or a TOML file. Without it, all built-in studies are listed.",
            autocompletion=complete_study,
        ),
    ] = None,
    out_dir: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            show_default="studies/NAME",
            help="Write the results into this folder, which is new or of the same study.",
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Make few runs, as the table quick of the study says.")
    ] = False,
    jobs: Jobs = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT", help="Run on the Dask cluster of this scheduler."),
    ] = None,
    retry: Annotated[bool, typer.Option("--retry", help="Repeat the runs that failed.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List the runs without making them.")] = False,
    show: Annotated[bool, typer.Option("--show", help="Print a built-in study, to save and change.")] = False,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema of study files.")] = False,
) -> int:
    """Run a scenario many times; collect the outcomes in a table.

    The same command continues a study that was interrupted.

    Exit code 0 if all went well, 1 if a run failed, 2 for bad input.
    """
    from skyherd.study.plan import make_plan
    from skyherd.study.spec import StudySpec, load_study, study_text

    if schema:
        typer.echo(json.dumps(StudySpec.model_json_schema(), indent=2))
        return 0
    if name is None:
        return _list()
    if show:
        typer.echo(study_text(name), nl=False)
        return 0
    if jobs is not None and scheduler is not None:
        raise InputError(
            "--jobs", "given with --scheduler", "one of them: a cluster has its own number of workers"
        )
    _require_extra()
    checked = load_study(name, quick=quick)
    folder = out_dir or Path("studies") / (f"{checked.name}-quick" if quick else checked.name)
    plan = make_plan(checked)
    return _preview(plan, folder, retry) if dry_run else _conduct(plan, folder, scheduler, jobs, retry)


def _list() -> int:
    from skyherd.study.spec import load_study, study_names

    for name in study_names():
        say(f"{name}: {load_study(name).spec.description}")
    return 0


def _require_extra() -> None:
    """Check that everything is installed that studies need beyond the rest.

    Raises:
        InputError: a module of the extra is missing; the message has the command that installs it.
    """
    from skyherd.plugins import import_extra

    for module in EXTRA:
        import_extra(module, module, "skyherd study", "study")


def _preview(plan: "Plan", folder: Path, retry: bool) -> int:
    """Print a line for each run: whether it is done, and its parameters."""
    from skyherd.study.conduct import preview

    missing = preview(plan, folder, retry=retry)
    for number, run in enumerate(plan.runs, 1):
        say(f"{number:5d}  {'to do' if run.key in missing else 'done '}  {run.text()}")
    say(f"{len(plan.runs)} runs, {len(missing)} to do, in {folder}")
    return 0


def _conduct(plan: "Plan", folder: Path, scheduler: str | None, jobs: int | None, retry: bool) -> int:
    """Make the runs that are missing, and say where the results are."""
    from skyherd.study.conduct import conduct, runs_per_s

    with (
        telling_of_interrupts("finished runs are kept, and the same command continues from here"),
        ProgressReporter() as progress,
    ):
        report = conduct(plan, folder, progress, scheduler=scheduler, jobs=jobs, retry=retry)
    failed = (
        f", {report.failed} failed: see {folder / 'table.md'}; --retry repeats them" if report.failed else ""
    )
    made = (
        f", {report.made} made at {runs_per_s(report.made, report.elapsed_s):.3g} a second"
        if report.made
        else ""
    )
    say(f"{folder}: {report.runs} runs{made}{failed}")
    say("see " + "  ".join(str(path) for path in [*report.pages, report.table]))
    return 1 if report.failed else 0
