"""The command line: one file a verb, each thin: parse, check, one call.

A verb's file imports typer, the standard library and its neighbours here at its top, and everything else
inside the function that calls it: help and completion then answer at once, and a verb loads what it uses.

Exit codes: 0 done; 1 the run did not reach its goal, `detect --require` found a file without a marker, of
`study` a run failed, `dataset check` found a problem, `topology` a violated condition, or `survey` a
contradiction; 2 bad input or output; 130 interrupted.
"""

import io
import sys
from typing import Any

import typer

from skyherd.cli.bench import bench_app
from skyherd.cli.console import complain, complain_of, printing_input_warnings
from skyherd.cli.dataset import dataset_app
from skyherd.cli.detect import detect
from skyherd.cli.export import export
from skyherd.cli.help import HelpCommand, HelpGroup
from skyherd.cli.interrupts import (
    NOTHING_LEFT,
    Interrupted,
    describe,
    signals_as_interrupts,
    telling_of_interrupts,
)
from skyherd.cli.live import live_app
from skyherd.cli.live_processes import robot, unit, world
from skyherd.cli.markers import markers
from skyherd.cli.play import play
from skyherd.cli.report import report
from skyherd.cli.ros2 import ros2
from skyherd.cli.run import run
from skyherd.cli.scenario import scenario_app
from skyherd.cli.study import study
from skyherd.cli.survey import survey
from skyherd.cli.topology import topology
from skyherd.cli.track import track
from skyherd.cli.view import view
from skyherd.errors import InputError, SkyherdError
from skyherd.version import __version__

SUMMARY = "Steer ground robots into a shape by what uncalibrated flying cameras see."
"""The first line of the help."""


class Verbs(HelpGroup):
    """The verbs, whose interrupts pass: Typer would end the program before anything is said of them."""

    def invoke(self, ctx: Any) -> Any:
        """Carry out the verb that was asked for; Interrupted if it was interrupted."""
        with telling_of_interrupts(NOTHING_LEFT):
            return super().invoke(ctx)


app = typer.Typer(
    name="skyherd",
    cls=Verbs,
    help=SUMMARY,
    rich_markup_mode=None,
)
SIMULATE, MEASURE, STEER, DATA = "Simulate", "Detect and measure", "Steer real robots", "Data and reports"
"""Titles in the list of verbs."""

app.command(cls=HelpCommand, rich_help_panel=SIMULATE)(run)
app.command(cls=HelpCommand, rich_help_panel=SIMULATE)(play)
app.command(cls=HelpCommand, rich_help_panel=SIMULATE)(view)
app.add_typer(scenario_app, name="scenario", cls=HelpGroup, rich_help_panel=SIMULATE)
app.command(cls=HelpCommand, rich_help_panel=SIMULATE)(topology)
app.command(cls=HelpCommand, rich_help_panel=SIMULATE)(study)
app.command(cls=HelpCommand, rich_help_panel=MEASURE)(detect)
app.command(cls=HelpCommand, rich_help_panel=MEASURE)(track)
app.command(cls=HelpCommand, rich_help_panel=MEASURE)(survey)
app.command(cls=HelpCommand, rich_help_panel=MEASURE)(markers)
app.add_typer(bench_app, name="bench", cls=HelpGroup, rich_help_panel=MEASURE)
app.add_typer(
    live_app,
    name="live",
    cls=HelpGroup,
    rich_help_panel=STEER,
    help="Check, run, arm and stop a lab of real cameras and robots.",
)
app.command(
    cls=HelpCommand, rich_help_panel=STEER, short_help="Run the process of one aerial unit of a lab."
)(unit)
app.command(cls=HelpCommand, rich_help_panel=STEER, short_help="Run the process of one robot of a lab.")(
    robot
)
app.command(
    cls=HelpCommand, rich_help_panel=STEER, short_help="Simulate a lab's cameras and robots in real time."
)(world)
app.command(
    cls=HelpCommand, rich_help_panel=STEER, short_help="Publish the markers that a camera sees, for ROS 2."
)(ros2)
app.command(cls=HelpCommand, rich_help_panel=DATA)(report)
app.command(cls=HelpCommand, rich_help_panel=DATA)(export)
app.add_typer(dataset_app, name="dataset", cls=HelpGroup, rich_help_panel=DATA)
for group in (live_app, scenario_app, bench_app, dataset_app):
    for registered in group.registered_commands:
        registered.cls = HelpCommand


def _version(show: bool) -> None:
    if show:
        typer.echo(f"skyherd {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True, help=SUMMARY)
def _options(
    context: typer.Context,
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Show the version."
    ),
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _check_none_is_empty(arguments: list[str]) -> None:
    """Refuse empty arguments, which no verb takes: an empty path would be the working folder."""
    for before, argument in zip(["", *arguments], arguments, strict=False):
        if argument == "" or (argument.startswith("--") and argument.endswith("=")):
            where = argument.removesuffix("=") or f"the argument after {before or 'skyherd'}"
            raise InputError(where, "is empty", "give a name or a value, or leave it out")


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code; each problem of the input is a line on stderr."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without UTF-8 shows what it lacks escaped
            stream.reconfigure(errors="backslashreplace")
    try:
        _check_none_is_empty(sys.argv[1:] if arguments is None else arguments)
        with signals_as_interrupts(), printing_input_warnings():
            code = app(arguments, standalone_mode=False, prog_name="skyherd")
    except SkyherdError as error:
        complain_of(error)
        code = error.exit_code
    except OSError as error:
        complain(f"{error.filename or 'output'}: {error.strerror or error}; nothing after this was written")
        code = 2
    except MemoryError:
        complain("not enough memory; give a smaller input, or fewer --jobs")
        code = 2
    except (Interrupted, KeyboardInterrupt, typer.Abort) as error:
        said, code = describe(error)
        complain(said)
    sys.exit(code or 0)
