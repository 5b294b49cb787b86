"""Shared parts of the benchmarks' command lines: lists of numbers, thresholds, and errors as one line."""

import argparse
from collections.abc import Callable
from typing import Any

from skyherd.errors import SkyherdError
from skyherd.vision.photometric.evidence import likelihood


def numbers(text: str) -> list[float]:
    """Return the numbers of a list with commas, such as `12,20`; a ValueError is argparse's."""
    return [float(part) for part in text.split(",")]


THRESHOLDS = {
    "MIN_LOG_ODDS": "log odds from which on photometric accepts a candidate",
    "ROBUST_LOG_ODDS": "log odds that a robust fit adds to them",
    "LIKE_LOG_ODDS": "log odds that another marker of like size adds",
}
"""What options can change, by the name of the constant."""


def add_thresholds(parser: argparse.ArgumentParser) -> None:
    """Add the options of the log odds from which on `photometric` accepts candidates."""
    for name, words in THRESHOLDS.items():
        option = f"--{name.lower().replace('_', '-')}"
        parser.add_argument(option, type=float, action=_Threshold, const=name, help=words)


class _Threshold(argparse.Action):
    """Replaces the threshold that `const` names, in this process."""

    def __call__(self, parser: object, given: argparse.Namespace, value: Any, option: object = None) -> None:
        setattr(likelihood, str(self.const), value)
        setattr(given, self.dest, value)


def run(main: Callable[[], None]) -> None:
    """Call the benchmark, and end with one line for invalid input."""
    try:
        main()
    except SkyherdError as error:
        raise SystemExit(f"error: {error}") from None
