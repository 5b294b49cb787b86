"""Measurement of time per frame, on one thread: moving markers, clean and noisy, at four resolutions.

All detectors process a frame one after the other before the next one comes, so that other load affects all of
them alike. Ratios are to `cv2.aruco` at its defaults in the same run. A slow detector is skipped once it has
used up its time. Trackers get every frame, so that their scheduled searches of the whole image count.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skyherd.bench.detectors.design import Cell
from skyherd.bench.entrants import REFERENCE, dictionary_for
from skyherd.bench.execution import Entrant, Plan, Row, time_row
from skyherd.jobs.helpers import one_thread
from skyherd.jobs.progress import NO_PROGRESS, Progress

WARM_UP = 3
"""Number of ignored first frames: caches fill, memory is allocated, and trackers find their markers."""

MIN_FRAMES = 6
"""Minimum number of timed frames of any detector. Chosen: the median of fewer depends on single frames."""

TASK = "time per frame"
"""Name of this part of the benchmark in progress reports."""

SIZES_PX = ((640, 480), (1280, 960), (1920, 1080), (3840, 2160))
NOISES = (0.0, 5.0)
SIDE_PX = 30.0
"""Sizes of the images, px, noises, grey levels, and side of the markers, px."""


@dataclass(frozen=True)
class TimingCell(Cell):
    """A condition whose image size, px, does not follow from the side of its markers."""

    image_px: tuple[int, int] = (640, 480)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images, px."""
        return self.image_px


def timing_cells(frames: int, sizes_px: Sequence[tuple[int, int]] = SIZES_PX) -> list[TimingCell]:
    """Return cells of sixteen markers of 30 px and one camera at each size, clean and noisy."""
    base = TimingCell(sweep="timing", side_px=SIDE_PX, blur_px=0.8, cameras=1, frames=frames)
    return [replace(base, image_px=size, noise=noise) for size in sizes_px for noise in NOISES]


def measure_times(
    plan: Plan,
    cells: Sequence[TimingCell],
    budget_s: float,
    *,
    progress: Progress = NO_PROGRESS,
) -> list[Row]:
    """Measure the time per frame in all cells.

    Args:
        plan: detectors and frames.
        cells: the conditions.
        budget_s: time after which a detector skips the rest of a cell, except for `MIN_FRAMES` frames.
        progress: receives the number of finished cells.

    Returns:
        a row for each cell and detector.
    """
    rows = []
    for index, cell in enumerate(cells):
        rows += _measure(plan, cell, index, budget_s)
        progress.update(TASK, index + 1, len(cells))
    return rows


def _measure(plan: Plan, cell: TimingCell, index: int, budget_s: float) -> list[Row]:
    dictionaries = {name: dictionary_for(name, plan.dictionary) for name in plan.detectors}
    entrants = {name: Entrant(name, dictionaries[name], plan.corrected) for name in plan.detectors}
    streams = {
        dictionary: plan.source(cell, dictionary, plan.seed + 7919 * (index + 1))
        for dictionary in dict.fromkeys(dictionaries.values())
    }
    with one_thread():
        for _ in range(cell.frames):
            active = [name for name, entrant in entrants.items() if not _spent(entrant, budget_s)]
            shown = {wanted: next(streams[wanted]) for wanted in {dictionaries[name] for name in active}}
            for name in active:
                entrants[name].measure(shown[dictionaries[name]])
    return [_row(cell, entrant, dictionaries[name], entrants) for name, entrant in entrants.items()]


def _spent(entrant: Entrant, budget_s: float) -> bool:
    taken = len(entrant.times_ms) - WARM_UP
    return taken >= MIN_FRAMES and sum(entrant.times_ms) > 1e3 * budget_s


def _row(cell: TimingCell, entrant: Entrant, dictionary: str, entrants: dict[str, Entrant]) -> Row:
    row = entrant.row()
    width, height = cell.size_px
    times = _counted(entrant)
    reference = entrants.get(REFERENCE)
    median = float(np.median(times))
    return {
        "detector": entrant.name,
        "dictionary": dictionary,
        "width_px": width,
        "height_px": height,
        "noise": cell.noise,
        "side_px": cell.side_px,
        "frames": len(times),
        "recall": row["recall"],
        **time_row(times),
        "times_faster": None if reference is None else float(np.median(_counted(reference))) / median,
    }


def _counted(entrant: Entrant) -> list[float]:
    return entrant.times_ms[WARM_UP:] or entrant.times_ms
