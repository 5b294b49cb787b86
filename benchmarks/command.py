"""Shared parts of the benchmarks' command lines: lists of numbers, and errors as one line."""

from collections.abc import Callable

from skyherd.errors import SkyherdError


def numbers(text: str) -> list[float]:
    """Return the numbers of a list with commas, such as `12,20`; a ValueError is argparse's."""
    return [float(part) for part in text.split(",")]


def run(main: Callable[[], None]) -> None:
    """Call the benchmark, and end with one line for invalid input."""
    try:
        main()
    except SkyherdError as error:
        raise SystemExit(f"error: {error}") from None
