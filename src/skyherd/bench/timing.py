"""Time per frame, one thread: consecutive frames of moving markers, clean and noisy, at four resolutions.

All detectors take each frame in turn, so that whatever else the machine does hits them alike; ratios are to
`cv2.aruco` at its defaults in the same run. A slow detector leaves once it has spent its time; trackers see
every frame, so that their scheduled passes over the full frame are in the figures.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skyherd.bench.design import Cell
from skyherd.bench.entrants import REFERENCE, dictionary_for
from skyherd.bench.execution import Entrant, Plan, Row, one_thread, time_row
from skyherd.progress import NO_PROGRESS, Progress

WARM_UP = 3
"""First frames that are not counted: there patterns are made, memory is claimed, and trackers acquire."""

FEWEST = 6
SIZES_PX = ((640, 480), (1280, 960), (1920, 1080), (3840, 2160))
TASK = "time per frame"
"""Name of this part of the benchmark in progress reports."""

NOISES = (0.0, 5.0)
SIDE_PX = 30.0


@dataclass(frozen=True)
class TimingCell(Cell):
    """A condition at a resolution of its own."""

    image_px: tuple[int, int] = (640, 480)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images."""
        return self.image_px


def timing_cells(frames: int, sizes_px: Sequence[tuple[int, int]] = SIZES_PX) -> list[TimingCell]:
    """Sixteen markers of 30 px, clean and noisy, one camera."""
    base = TimingCell(sweep="timing", side_px=SIDE_PX, blur_px=0.8, cameras=1, frames=frames)
    return [replace(base, image_px=size, noise=noise) for size in sizes_px for noise in NOISES]


def measure_times(
    plan: Plan,
    cells: Sequence[TimingCell],
    budget_s: float,
    *,
    progress: Progress = NO_PROGRESS,
) -> list[Row]:
    """Rows of all cells: one for each detector; none takes more than about `budget_s` in a cell."""
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
            taking = [name for name, entrant in entrants.items() if not _spent(entrant, budget_s)]
            shown = {wanted: next(streams[wanted]) for wanted in {dictionaries[name] for name in taking}}
            for name in taking:
                entrants[name].take(shown[dictionaries[name]])
    return [_row(cell, entrant, dictionaries[name], entrants) for name, entrant in entrants.items()]


def _spent(entrant: Entrant, budget_s: float) -> bool:
    taken = len(entrant.times_ms) - WARM_UP
    return taken >= FEWEST and sum(entrant.times_ms) > 1e3 * budget_s


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
