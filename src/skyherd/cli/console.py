"""Output of the command line: results go to stdout; errors, warnings and progress go to stderr."""

import warnings
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self

import typer

from skyherd.cli.keywords import error_lines, with_options
from skyherd.errors import InputWarning, SkyherdError
from skyherd.text import printable, shorten

MAX_CHARACTERS = 480
"""Characters of a line on stderr, without its first word. Chosen: six lines of a terminal."""


def say(text: str, *, bold: bool = False) -> None:
    """Print a line of results on stdout; what a terminal would obey is escaped."""
    typer.secho(printable(text), bold=bold)


def complain(text: str) -> None:
    """Print an error on stderr, as one line of less than 500 characters whatever the text."""
    typer.echo(f"error: {_one_line(text)}", err=True)


def complain_of(error: SkyherdError) -> None:
    """Print each problem of an error on stderr as `complain` does, with options for parameters."""
    for line in error_lines(error):
        complain(line)


def warn(text: str) -> None:
    """Print a warning on stderr, as one line of less than 500 characters, with options for parameters."""
    typer.echo(f"warning: {_one_line(with_options(text))}", err=True)


@contextmanager
def printing_input_warnings() -> Iterator[None]:
    """Print warnings about inputs in the body as `warn` does, each text once."""
    said: set[str] = set()
    usual = warnings.showwarning

    def show(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
        if not issubclass(category, InputWarning):
            usual(message, category, *where, **more)
        elif str(message) not in said:
            said.add(str(message))
            warn(str(message))

    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        warnings.showwarning = show
        yield


def _one_line(text: str) -> str:
    return shorten(printable(" ".join(text.split())), MAX_CHARACTERS)


PIPE_WIDTH = 100_000
"""Width of a table that is not printed on a terminal, characters. Chosen: no cell is that long."""


def say_table(
    header: Sequence[str], rows: Iterable[Sequence[str]], *, right_aligned: Collection[str] = ()
) -> None:
    """Print a table without lines on stdout, wrapped to the width of a terminal; nothing without rows.

    Args:
        header: name of each column.
        rows: the cells, a row as long as the header.
        right_aligned: names of the columns whose cells end at the column's right edge.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, header_style="bold")
    for column in header:
        table.add_column(column, justify="right" if column in right_aligned else "left")
    for row in rows:
        table.add_row(*(Text(printable(cell, keep="\n")) for cell in row))
    if table.row_count:
        console = Console(highlight=False, soft_wrap=True)
        # Through a pipe nothing wraps, so that each row has its whole cells.
        if not console.is_terminal:
            console.width = PIPE_WIDTH
        console.print(table)


class ProgressReporter:
    """A `skyherd.jobs.progress.Progress` that draws a bar on stderr; nothing where stderr is no terminal.

    One bar is shown at a time. An `update` with a new name replaces it, so that the parts of a job, or its
    files, follow each other. Use it in a `with` block, at the end of which the bar disappears.
    """

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        console = Console(stderr=True, highlight=False, soft_wrap=True)
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[state]}", markup=False),
            TimeElapsedColumn(),
            TextColumn("left:"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
        self._name = ""
        self._bar = self._progress.add_task("", visible=False, state="")

    def __enter__(self) -> Self:
        """Show the bar from now on."""
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Remove the bar from the terminal."""
        self._progress.stop()

    def update(self, name: str, done: float, total: float | None, state: str | None = None) -> None:
        """Show how far the part of this name is.

        Args:
            name: what is being done, shown before the bar.
            done: amount that is done, in any unit.
            total: amount in all, in the same unit; None while it is not known.
            state: text after the bar; `done/total` if left out.
        """
        if name != self._name:
            self._progress.remove_task(self._bar)
            self._name, self._bar = name, self._progress.add_task(printable(name), total=None, state="")
        counted = f"{done:g}/{'?' if total is None else format(total, 'g')}"
        self._progress.update(
            self._bar, completed=done, total=total, state=counted if state is None else state
        )
