"""One run of a study on a worker: from the mission to the stored values, without any file."""

from collections.abc import Sequence
from time import perf_counter
from typing import Any

import cv2

from skyherd.analysis.history import make_history
from skyherd.analysis.summary import summarize
from skyherd.datasets import Mission
from skyherd.errors import SkyherdError
from skyherd.loop import run_steps
from skyherd.study.spec import CURVE, SUMMARY_FIELDS

Outcome = dict[str, Any]
"""Stored values of a run: `key`, `error`, fields of the summary, and arrays of the history."""


def measure(key: str, mission: Mission, curves: Sequence[str]) -> Outcome:
    """Run a mission on one thread; any exception becomes the outcome's error, so that other runs continue.

    Args:
        key: key of the run.
        mission: mission to run.
        curves: fields of `skyherd.analysis.history.History` to keep.

    Returns:
        `key`, `error` (None without one), the summary's values (None for missing ones), and the named arrays
        of the history as `history.NAME`.
    """
    cv2.setNumThreads(1)
    started_s = perf_counter()
    try:
        history = make_history(mission, run_steps(mission))
        summary = summarize(history, perf_counter() - started_s)
    except SkyherdError as error:
        return failure(key, str(error))
    except Exception as error:  # Any error: the other runs must continue.
        return failure(key, f"{type(error).__name__}: {error}")
    values = {name: summary.get(name) for name in SUMMARY_FIELDS}
    return {"key": key, "error": None, **values, **{CURVE + name: getattr(history, name) for name in curves}}


def failure(key: str, error: str) -> Outcome:
    """Return the outcome of a failed run, with its error as one line."""
    return {"key": key, "error": " ".join(error.split()) or "an error without a message"}
