"""How the command line speaks: results on stdout, the rest on stderr."""

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

out = Console(highlight=False, soft_wrap=True)
err = Console(stderr=True, highlight=False, soft_wrap=True)


class CountBar(Progress):
    """A bar that counts what is done; nothing where stderr is no terminal."""

    def __init__(self) -> None:
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=err,
            disable=not err.is_terminal,
            transient=True,
        )


def complain(text: str) -> None:
    """One line on stderr that says what was wrong."""
    line = " ".join(text.split())
    err.print(f"error: {line}", markup=False)


def warn(text: str) -> None:
    """One line on stderr that says what looks wrong."""
    err.print(f"warning: {text}", markup=False)
