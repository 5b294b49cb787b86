"""Figure of a study of formation controllers: a row per method, a column per task, a number in each cell."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize
from matplotlib.figure import Figure

from skyherd.drawing.palette import INK, MUTED, PAPER
from skyherd.geometry import Array, BoolArray
from skyherd.plots.style import new_figure, plain
from skyherd.study.methods.outcomes import Method, Outcomes

GOOD = LinearSegmentedColormap.from_list("good", [PAPER, "#9fd3bd"])
BAD = LinearSegmentedColormap.from_list("bad", [PAPER, "#f0b48a"])
"""Cell colours: green for good values, orange for bad ones."""


@dataclass(frozen=True)
class Board:
    """One quantity of all methods and tasks: title, value, cell text and shading."""

    title: str
    value: Callable[[Outcomes], float]
    text: str
    colors: LinearSegmentedColormap
    log: bool = False


BOARDS = (
    Board("formed the shape (%)", lambda runs: share(runs.converged), "{:.0f}", GOOD),
    Board("formed an affine image of it (%)", lambda runs: share(runs.affine), "{:.0f}", GOOD),
    Board("collided (%)", lambda runs: share(runs.collided), "{:.0f}", BAD),
    Board("time to 1 % of the shape (s)", lambda runs: median(runs.times_s), "{:.3g}", BAD, log=True),
    Board("path over the shortest", lambda runs: median(runs.detours), "{:.2f}", BAD, log=True),
    Board("numbers per robot and second", lambda runs: median(runs.numbers_ps), "{:.0f}", BAD, log=True),
)
"""Quantities of the figure; times, paths and numbers are medians over the runs that have one."""


def draw_methods(methods: Sequence[Method]) -> Figure:
    """Draw boards with a row per method and a column per task. A dash marks cells without a value."""
    tasks = list(methods[0].outcomes)
    figure = new_figure(1.6 + 0.56 * (len(methods) + 4), 12.5)
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    for axes, board in zip(panels.flat, BOARDS, strict=True):
        values = np.array([[board.value(method.outcomes[task]) for task in tasks] for method in methods])
        _draw_board(axes, board, values)
    for axes in panels[:, 0]:
        axes.set_yticks(range(len(methods)), [plain(method.name) for method in methods])
    for axes in panels[-1]:
        axes.set_xticks(range(len(tasks)), [plain(task) for task in tasks], rotation=35, ha="right")
    return figure


def _draw_board(axes: Axes, board: Board, values: Array) -> None:
    known = values[np.isfinite(values)]
    least, most = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    if board.log and least > 0:
        norm: Normalize = LogNorm(least, max(most, 1.01 * least))
    else:
        norm = Normalize(0.0, 100.0)
    axes.imshow(np.ma.masked_invalid(values), cmap=board.colors, norm=norm, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        text, color = (board.text.format(value), INK) if np.isfinite(value) else ("–", MUTED)
        axes.text(column, row, text, ha="center", va="center", color=color, fontsize="small")
    axes.set_title(board.title)
    axes.set_xticks(np.arange(values.shape[1] + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(values.shape[0] + 1) - 0.5, minor=True)
    axes.grid(visible=False)
    axes.grid(visible=True, which="minor", color=MUTED, linewidth=0.4)
    axes.tick_params(which="both", length=0)


def share(yes: BoolArray) -> float:
    """Return the share of true values, per cent; NaN of none."""
    return 100 * float(np.mean(yes)) if yes.size else np.nan


def median(values: Array) -> float:
    """Return the median of the finite values; NaN of none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan
