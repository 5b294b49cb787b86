"""The command line: one file a verb, each thin: parse, check, one call.

A verb's file imports typer, the standard library and its neighbours here at its top, and everything else
inside the function that calls it: help and completion then answer at once, and a verb loads what it uses.

Exit codes: 0 done; 1 the run did not reach its goal, `detect --require` found a file without a marker, of
`study` a run failed, `dataset check` found a problem, or `topology` a violated condition; 2 bad input or
output; 130 interrupted.
"""

import sys
from typing import Any, cast

import typer

from skyherd.cli.bench import bench_app
from skyherd.cli.console import complain
from skyherd.cli.dataset import dataset_app
from skyherd.cli.detect import detect
from skyherd.cli.markers import markers
from skyherd.cli.report import report
from skyherd.cli.run import run
from skyherd.cli.scenario import scenario_app
from skyherd.cli.study import study
from skyherd.cli.topology import topology
from skyherd.errors import SkyherdError
from skyherd.version import __version__

UsageError: type[Exception] = typer.BadParameter.__base__ or typer.BadParameter
"""Root of what Typer raises for wrong arguments: click's, or that of its own copy of click."""

app = typer.Typer(
    name="skyherd",
    help="Steer a team of ground robots into a shape with nothing but what uncalibrated flying cameras see.",
    rich_markup_mode=None,
)
app.command()(run)
app.command()(report)
app.command()(topology)
app.command()(detect)
app.command()(markers)
app.command()(study)
app.add_typer(scenario_app, name="scenario")
app.add_typer(bench_app, name="bench")
app.add_typer(dataset_app, name="dataset")


def _version(show: bool) -> None:
    if show:
        typer.echo(f"skyherd {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Show the version."
    ),
) -> None:
    """Steer a team of ground robots into a shape with nothing but what uncalibrated flying cameras see."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code; what a user got wrong is one line on stderr."""
    try:
        code = app(arguments, standalone_mode=False, prog_name="skyherd")
    except UsageError as error:
        complain(f"{cast(Any, error).format_message()}; see `skyherd --help`")
        code = 2
    except SkyherdError as error:
        complain(str(error))
        code = error.exit_code
    except OSError as error:
        complain(f"{error.filename or 'output'}: {error.strerror or error}; nothing after this was written")
        code = 2
    except (KeyboardInterrupt, typer.Abort):
        complain("interrupted; what was recorded can be seen with `skyherd report DIR`")
        code = 130
    sys.exit(code or 0)
