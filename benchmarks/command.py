"""Shared parts of the benchmarks' command lines: lists of numbers, thresholds, and errors as one line."""

import argparse
from collections.abc import Callable
from typing import Any

from skyherd.errors import SkyherdError
from skyherd.vision.photometric.evidence import likelihood


def numbers(text: str) -> list[float]:
    """Return the numbers of a list with commas, such as `12,20`; a ValueError is argparse's."""
    return [float(part) for part in text.split(",")]


def add_thresholds(parser: argparse.ArgumentParser) -> None:
    """Add the options of other log odds from which on `photometric` accepts candidates."""
    for name, measured in (("MIN_LOG_ODDS", "its edges alone"), ("MIN_ROBUST_LOG_ODDS", "a robust fit")):
        option = f"--{name.lower().replace('_', '-')}"
        words = f"log odds from which on photometric accepts a candidate that is measured by {measured}"
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
