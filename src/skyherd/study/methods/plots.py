"""The figure of a study of formation controllers: success, time, path length and gap, a row a method."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullLocator, ScalarFormatter

from skyherd.drawing.palette import INK, MUTED, UNIT_COLORS
from skyherd.geometry import Array
from skyherd.plots.style import legend_above, new_figure
from skyherd.study.methods.outcomes import Method, Outcomes

MARKS = "osD^vPX<"
"""Matplotlib markers of the kinds of start, in the study's order, beside their colours."""

SPREAD = 0.62
"""Height over which the starts of one method are spread, as a share of the distance between two methods.
Chosen: towards 1 the last start of a method lies as near to the next method as to its own, towards 0 the
markers of the starts overlap."""


def draw_methods(methods: Sequence[Method]) -> Figure:
    """Draw panels with a row a method: share of runs that formed the shape, time, path length, least gap.

    Each kind of start has a colour and a marker, at the median of its runs; a line goes from the least value
    to the greatest.
    """
    starts = list(methods[0].outcomes)
    figure = new_figure(1.6 + 0.52 * len(methods), 12.0)
    panels: Sequence[Axes] = figure.subplots(1, 4, sharey=True, width_ratios=[0.62, 1, 1, 1])
    offsets = np.linspace(-SPREAD / 2, SPREAD / 2, len(starts)) if len(starts) > 1 else np.zeros(1)
    for row, method in enumerate(methods):
        for index, start in enumerate(starts):
            place, runs = row + float(offsets[index]), method.outcomes[start]
            style: dict[str, Any] = {
                "color": UNIT_COLORS[index % len(UNIT_COLORS)],
                "marker": MARKS[index % len(MARKS)],
            }
            _dot(panels[0], place, 100 * _share(runs), style)
            _range(panels[1], place, runs.times_s, style)
            _range(panels[2], place, runs.paths_m, style)
            _range(panels[3], place, runs.gaps_m, style)
    _finish_panels(panels, methods)
    legend_above(figure, _handles(starts), columns=4)
    return figure


def _finish_panels(panels: Sequence[Axes], methods: Sequence[Method]) -> None:
    """Labels, grids and limits of the four panels."""
    labels = ("formed the shape (%)", "time to 1 % (s)", "way of all robots (m)", "least gap (m)")
    for axes, label in zip(panels, labels, strict=True):
        axes.set_xlabel(label)
        axes.grid(visible=True, axis="x", alpha=0.4)
        for row in range(1, len(methods)):
            axes.axhline(row - 0.5, color=MUTED, linewidth=0.4)
    panels[0].set_xlim(-6, 106)
    panels[1].set_xscale("log")
    panels[1].xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    panels[1].xaxis.set_major_formatter(ScalarFormatter())
    panels[1].xaxis.set_minor_locator(NullLocator())
    panels[2].set_xlim(left=0)
    panels[3].axvline(0.0, color=INK, linewidth=1.0)
    panels[3].set_title("touching, left of the line", fontsize="small")
    panels[0].set_yticks(range(len(methods)), [method.name for method in methods])
    panels[0].set_ylim(len(methods) - 0.5, -0.5)


def _share(runs: Outcomes) -> float:
    return float(np.mean(runs.converged)) if runs.converged.size else np.nan


def _dot(axes: Axes, place: float, value: float, style: dict[str, Any]) -> None:
    axes.plot([value], [place], linestyle="", markersize=5, clip_on=False, **style)


def _range(axes: Axes, place: float, values: Array, style: dict[str, Any]) -> None:
    """Draw the median, and a line from the least value to the greatest; nothing if all are NaN."""
    known = values[np.isfinite(values)]
    if known.size:
        axes.plot([known.min(), known.max()], [place, place], color=style["color"], linewidth=1.2, alpha=0.7)
        _dot(axes, place, float(np.median(known)), style)


def _handles(starts: Sequence[str]) -> list[Line2D]:
    return [
        Line2D(
            [], [], color=UNIT_COLORS[i % len(UNIT_COLORS)], marker=MARKS[i % len(MARKS)], ls="", label=start
        )
        for i, start in enumerate(starts)
    ]
