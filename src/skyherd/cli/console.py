"""How the command line speaks: results on stdout, the rest on stderr."""

from types import TracebackType
from typing import Self

from rich.console import Console

out = Console(highlight=False, soft_wrap=True)
err = Console(stderr=True, highlight=False, soft_wrap=True)


class ProgressReporter:
    """A `skyherd.progress.Progress` that draws a bar on stderr; nothing where stderr is no terminal.

    One bar is shown at a time. An `update` with a new name replaces it, so that the parts of a job, or its
    files, follow each other. Use it in a `with` block, at the end of which the bar disappears.
    """

    def __init__(self) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[state]}", markup=False),
            TimeElapsedColumn(),
            TextColumn("left:"),
            TimeRemainingColumn(),
            console=err,
            disable=not err.is_terminal,
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
            self._name, self._bar = name, self._progress.add_task(name, total=None, state="")
        counted = f"{done:g}/{'?' if total is None else format(total, 'g')}"
        self._progress.update(
            self._bar, completed=done, total=total, state=counted if state is None else state
        )


def complain(text: str) -> None:
    """One line on stderr that says what was wrong."""
    line = " ".join(text.split())
    err.print(f"error: {line}", markup=False)


def warn(text: str) -> None:
    """One line on stderr that says what looks wrong."""
    err.print(f"warning: {text}", markup=False)
