"""The reference of the command line as Markdown, from the program itself."""

from collections.abc import Iterator
from typing import Any

import typer

from skyherd.cli import app
from skyherd.cli.help import parameter_rows

INTRODUCTION = """\
# Command line

Made from the program when this site is built, so that it says what `skyherd VERB --help` says.
`skyherd --install-completion` sets up completion of verbs, options and their values for your shell.

Exit codes of all verbs: 0 done; 1 the answer is no (the shape was not reached, a condition is violated, a
run failed, a file has no marker under `--require`, no robot was tracked, a data set has a problem, a robot
did not answer, a decision comes out differently); 2 bad input or output; 130 after Ctrl-C,
and 143 after SIGTERM.
"""


def cli_reference() -> str:
    """The whole page: a section for each verb with its usage, what it does, its arguments and options."""
    parts = [INTRODUCTION]
    for name, verb in verbs(typer.main.get_command(app), "skyherd"):
        parts += section(name, verb)
    return "\n".join(parts)


def verbs(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Every command below a group that is no group itself, with its full name, in the order of the help."""
    for word, below in getattr(command, "commands", {}).items():
        if hasattr(below, "commands"):
            yield from verbs(below, f"{name} {word}")
        else:
            yield f"{name} {word}", below


def section(name: str, verb: Any) -> Iterator[str]:
    """The section of one verb."""
    context = typer.Context(verb, info_name=name)
    yield f"## `{name}`\n"
    yield f"{verb.help}\n"
    yield f"```\n{' '.join(verb.get_usage(context).removeprefix('Usage: ').split())}\n```\n"
    arguments, options = parameter_rows(verb, context)
    rows = []
    for words, meaning in [*arguments, *options]:
        text = in_cell(meaning).replace("[", r"\[")  # a bracket would begin a link
        rows.append(f"| `{in_cell(words)}` | {text} |")
    if rows:
        yield "\n".join(["| argument or option | meaning |", "|---|---|", *rows, ""])


def in_cell(text: str) -> str:
    """A text as it is written into one cell of a table, in which a bar would end the cell."""
    return " ".join(text.split()).replace("|", "\\|")
