"""How the command line speaks: results on stdout, the rest on stderr."""

from rich.console import Console

out = Console(highlight=False, soft_wrap=True)
err = Console(stderr=True, highlight=False, soft_wrap=True)


def complain(text: str) -> None:
    """One line on stderr that says what was wrong."""
    line = " ".join(text.split())
    err.print(f"error: {line}", markup=False)


def warn(text: str) -> None:
    """One line on stderr that says what looks wrong."""
    err.print(f"warning: {text}", markup=False)
