"""Shared parts of the benchmarks' command lines: lists of numbers, thresholds, and errors as one line."""

import argparse
from collections.abc import Callable
from typing import Any

from skyherd.errors import SkyherdError
from skyherd.vision.photometric.evidence import likelihood


def numbers(text: str) -> list[float]:
    """Return the numbers of a list with commas, such as `12,20`; a ValueError is argparse's."""
    return [float(part) for part in text.split(",")]


def add_min_robust_log_odds(parser: argparse.ArgumentParser) -> None:
    """Add the option of another threshold for candidates of `photometric` with a robust fit."""
    parser.add_argument(
        "--min-robust-log-odds", type=float, action=_MinRobustLogOdds, help="threshold of photometric"
    )


class _MinRobustLogOdds(argparse.Action):
    """Replaces the threshold in this process."""

    def __call__(self, parser: object, given: argparse.Namespace, value: Any, option: object = None) -> None:
        likelihood.MIN_ROBUST_LOG_ODDS = value
        setattr(given, self.dest, value)


def run(main: Callable[[], None]) -> None:
    """Call the benchmark, and end with one line for invalid input."""
    try:
        main()
    except SkyherdError as error:
        raise SystemExit(f"error: {error}") from None
