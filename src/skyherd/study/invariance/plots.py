"""Figures of a study of cameras: errors of goals, paths and shape over one camera parameter."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from skyherd.drawing.palette import INK, MUTED, UNIT_COLORS
from skyherd.plots.panels import FigureFile, save_figure
from skyherd.plots.style import drawing_style, label_log_axis, legend_above, new_figure
from skyherd.study.invariance.measures import IDEAL, RENDERED, Measures, Point, Sweep

PANELS = (
    ("goals", "goals: displacement (marker sides)"),
    ("paths", "paths: deviation (marker sides)"),
    ("shape", "final shape error"),
)
"""Panels of a figure from left to right: the field of `Measures`, and the panel's title."""

MIN_SHOWN = 1e-6
"""Lower end of the logarithmic axes, where smaller values are drawn. Chosen: far above the rounding of exact
images and below detector noise, so that neither hides the other."""

MAX_TICKS = 6
"""Maximum number of parameter values with a tick each; more would overlap."""

AS_SEEN, RECTIFIED = UNIT_COLORS[1], UNIT_COLORS[0]
"""Colours of runs without and with rectification."""

KINDS: tuple[tuple[str, bool, str, dict[str, Any]], ...] = (
    (IDEAL, False, "as seen, exact", {"color": AS_SEEN, "ls": ":", "marker": "s", "mfc": "white", "ms": 7}),
    (RENDERED, False, "as seen, rendered", {"color": AS_SEEN, "ls": "-", "marker": "s", "ms": 4.5}),
    (
        IDEAL,
        True,
        "rectified, exact",
        {"color": RECTIFIED, "ls": ":", "marker": "o", "mfc": "white", "ms": 7},
    ),
    (RENDERED, True, "rectified, rendered", {"color": RECTIFIED, "ls": "-", "marker": "o", "ms": 4.5}),
)
"""Lines of a panel: kind of perception, use of rectification, name in the legend, and line style."""

PREDICTED: dict[str, Any] = {"color": INK, "ls": (0, (5, 3)), "lw": 1.2}


def draw_sweeps(sweeps: Iterable[Sweep], folder: Path) -> list[FigureFile]:
    """Draw a figure for each sweep into a folder, as PNG and SVG, in the order of the sweeps.

    Raises:
        OutputError: a file could not be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with drawing_style():
        return [
            save_figure(
                draw_sweep(sweep),
                folder,
                figure_name(sweep.name),
                sweep.name.capitalize(),
                caption(sweep),
            )
            for sweep in sweeps
        ]


def figure_name(sweep: str) -> str:
    """Return the name, without suffix, of the figure of a sweep, whose own name may be any text."""
    return re.sub(r"[^\w.-]", "-", sweep).lstrip(".") or "-"


def caption(sweep: Sweep) -> str:
    """Return the caption of a sweep's figure: its parameter, and membership in Property 1's class."""
    where = "Inside" if sweep.inside else "Outside"
    return f"{where} Property 1's class: {sweep.label}. The worst of the seeds at each value."


def draw_sweep(sweep: Sweep) -> Figure:
    """Draw errors of goals, paths and shape over the parameter's values, of the worst seed at each."""
    figure = new_figure(3.7, 11.0)
    panels: Sequence[Axes] = figure.subplots(1, 3)
    places, labels = _places(sweep.points)
    for axes, (field, title) in zip(panels, PANELS, strict=True):
        _draw_panel(axes, sweep, field, places)
        axes.set_title(title)
        axes.set_xlabel(sweep.label)
        if labels:
            axes.set_xticks(places, labels, rotation=35, ha="right")
        elif len(places) <= MAX_TICKS:
            axes.set_xticks(places, [f"{place:g}" for place in places])
    legend_above(figure, _handles(), columns=6)
    return figure


def _places(points: Sequence[Point]) -> tuple[list[float], list[str]]:
    """Return the axis positions of values, and their tick texts if they are not numeric."""
    values = [point.value for point in points]
    numbers = [value for value in values if not isinstance(value, str)]
    if len(numbers) == len(values):
        return numbers, []
    return [float(place) for place in range(len(values))], [str(value) for value in values]


def _draw_panel(axes: Axes, sweep: Sweep, field: str, places: Sequence[float]) -> None:
    def shown(measures: Iterable[Measures]) -> Any:
        return np.maximum(np.array([getattr(measure, field) for measure in measures], dtype=float), MIN_SHOWN)

    axes.fill_between(places, MIN_SHOWN / 2, shown(sweep.floors()), color=MUTED, alpha=0.25, lw=0)
    for perception, rectified, _, style in KINDS:
        values = shown(point.worst(perception, rectified=rectified) for point in sweep.points)
        axes.plot(places, values, **style)
    if not sweep.inside:
        predicted = np.array([getattr(point.predicted, field) for point in sweep.points], dtype=float)
        axes.plot(places, np.where(predicted < MIN_SHOWN, np.nan, predicted), **PREDICTED)
    axes.set_yscale("log")
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.lines])
    top = max(drawn[np.isfinite(drawn)], default=MIN_SHOWN)
    axes.set_ylim(MIN_SHOWN / 2, max(2 * top, 10 * MIN_SHOWN))
    label_log_axis(axes.yaxis)


def _handles() -> list[Any]:
    lines = [Line2D([], [], label=label, **style) for _, _, label, style in KINDS]
    noise = Line2D([], [], color=MUTED, alpha=0.4, lw=8, label="noise alone")
    return [*lines, Line2D([], [], label="predicted", **PREDICTED), noise]
