"""The reference of the command line as Markdown, from the program itself."""

from collections.abc import Iterator
from typing import Any

import typer

from skyherd.cli import app
from skyherd.cli.help import parameter_rows

INTRODUCTION = """\
# Command line

Generated from `skyherd VERB --help`. `skyherd --install-completion` installs shell completion.

| exit code | meaning |
|---|---|
| 0 | success |
| 1 | negative result |
| 2 | bad input or output, reported in one line |
| 130 | Ctrl-C |
| 143 | SIGTERM |

Negative results are: shape not reached, condition violated, run failed, no marker under `--require`, no robot
tracked, faulty data set, robot without answer, replay differs.
"""


def cli_reference() -> str:
    """Return the page: usage, description, arguments and options of each verb."""
    parts = [INTRODUCTION]
    for name, verb in verbs(typer.main.get_command(app), "skyherd"):
        parts += section(name, verb)
    return "\n".join(parts)


def verbs(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield every leaf command of a group with its full name, in the order of the help."""
    for word, below in getattr(command, "commands", {}).items():
        if hasattr(below, "commands"):
            yield from verbs(below, f"{name} {word}")
        else:
            yield f"{name} {word}", below


def section(name: str, verb: Any) -> Iterator[str]:
    """Yield the lines of the section of one verb."""
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
    """Escape a text for a table cell."""
    return " ".join(text.split()).replace("|", "\\|")
