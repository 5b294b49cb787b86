"""Accuracy measurement: every detector on the same frames, cell by cell, in parallel processes."""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, field
from multiprocessing import get_context
from time import perf_counter
from typing import Any

import numpy as np

from skyherd.bench.detectors.design import Cell
from skyherd.bench.detectors.frames import FrameSource, LabelledFrame, rendered_frames
from skyherd.bench.detectors.scorer import Scorer
from skyherd.bench.entrants import EntrantError, dictionary_for, make_entrant
from skyherd.errors import SkyherdError
from skyherd.jobs.helpers import one_thread
from skyherd.jobs.lifetime import start_worker
from skyherd.jobs.progress import NO_PROGRESS, Progress
from skyherd.messages import Detections
from skyherd.vision import Detector

Row = dict[str, Any]
"""A row of the result: the factors of a cell, and the measurements of one detector in it."""

TASK = "accuracy"
"""Name of this part of the benchmark in progress reports."""


@dataclass(frozen=True)
class Plan:
    """Detectors to measure, and their frames.

    Attributes:
        detectors: names, or `module:factory`.
        dictionary: dictionary of the markers, where a detector supports it.
        seed: seed of all frames.
        corrected: subtract the constant biases of the peers.
        source: source of the frames.
    """

    detectors: tuple[str, ...]
    dictionary: str
    seed: int
    corrected: bool = True
    source: FrameSource = field(default=rendered_frames)


def measure_cells(
    plan: Plan, cells: Sequence[Cell], *, jobs: int = 1, progress: Progress = NO_PROGRESS
) -> list[Row]:
    """Measure all cells, `jobs` of them at a time, each on one thread.

    Returns:
        the rows in the order of the cells, one for each detector and cell.

    Raises:
        InputError: a detector cannot be made.
        EntrantError: a detector raised an exception or crashed its process.
    """
    for name in plan.detectors:
        make_entrant(name, dictionary_for(name, plan.dictionary), corrected=plan.corrected)
    rows: dict[int, list[Row]] = {}
    if jobs == 1:
        for index, cell in enumerate(cells):
            rows[index] = measure_cell(plan, cell, index)
            progress.update(TASK, len(rows), len(cells))
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=start_worker) as pool:
            futures = {
                pool.submit(measure_cell, plan, cell, index): index for index, cell in enumerate(cells)
            }
            try:
                for future in as_completed(futures):
                    rows[futures[future]] = future.result()
                    progress.update(TASK, len(rows), len(cells))
            except BrokenProcessPool:
                raise EntrantError(
                    "a detector crashed its process; measure one at a time to see which"
                ) from None
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
    return [row for index in range(len(cells)) for row in rows[index]]


def measure_cell(plan: Plan, cell: Cell, index: int) -> list[Row]:
    """Measure one cell: a row for each detector, in the plan's order.

    Detectors of different dictionaries get frames of the same seed, so that only the bits of the markers
    differ.

    Args:
        plan: detectors and frames.
        cell: the condition.
        index: number of the cell, which determines the seed of its frames.
    """
    dictionaries = {name: dictionary_for(name, plan.dictionary) for name in plan.detectors}
    rows: dict[str, Row] = {}
    with one_thread():
        for dictionary in dict.fromkeys(dictionaries.values()):
            entrants = {
                name: Entrant(name, dictionary, plan.corrected)
                for name in plan.detectors
                if dictionaries[name] == dictionary
            }
            blurs_px = []
            for frame in plan.source(cell, dictionary, plan.seed + 1000 * index):
                blurs_px.append(frame.blur_px)
                for entrant in entrants.values():
                    entrant.measure(frame)
            for name, entrant in entrants.items():
                about = {"blur_px": float(np.mean(blurs_px)), "blur_given": cell.blur_px is not None}
                rows[name] = {
                    "detector": name, "dictionary": dictionary, **cell.factors(), **about, **entrant.row()
                }  # fmt: skip
    return [rows[name] for name in plan.detectors]


class Entrant:
    """One detector in one cell, with its score and its times so far."""

    def __init__(self, name: str, dictionary: str, corrected: bool = True) -> None:
        self.name = name
        self.detector: Detector = make_entrant(name, dictionary, corrected=corrected)
        self.scorer = Scorer()
        self.times_ms: list[float] = []

    def measure(self, frame: LabelledFrame) -> None:
        """Detect in one frame, time it and score the detections; EntrantError if the detector fails."""
        start = perf_counter()
        detections = self._detect(frame)
        self.times_ms.append(1e3 * (perf_counter() - start))
        self.scorer.add(frame, detections)

    def row(self) -> Row:
        """Return score and times so far, as a row of the result."""
        return {**asdict(self.scorer.score()), **time_row(self.times_ms)}

    def _detect(self, frame: LabelledFrame) -> Detections:
        try:
            return self.detector.detect(frame.image, time_s=frame.time_s, unit_id=frame.unit_id)
        except SkyherdError as error:
            raise EntrantError(f"detector {self.name}: {error}") from None
        except Exception as error:
            raise EntrantError(f"detector {self.name}: {type(error).__name__}: {error}") from error


def time_row(times_ms: Sequence[float]) -> Row:
    """Return median and 99th percentile of times, ms, as a part of a row; None without any."""
    if not times_ms:
        return {"ms_median": None, "ms_p99": None}
    return {"ms_median": float(np.median(times_ms)), "ms_p99": float(np.percentile(times_ms, 99))}
