"""Figure of the control topology over time: control sets, and validity of TC1-TC5."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from skyherd.analysis.history import History
from skyherd.analysis.topology_report import NOT_REQUIRED, required_conditions
from skyherd.analysis.tree_snapshot import TreeSnapshot
from skyherd.drawing.palette import INK, unit_color
from skyherd.geometry import Array, BoolArray
from skyherd.plots.style import legend_above, new_figure

HOLDS, BROKEN, SPARED = "#d5dae1", INK, "#eceff3"
"""Colours of times in which a condition holds, is violated, and does not hold but is not required."""

BAR = 0.76
"""Height of a bar, as a share of its row; the rest is a gap."""

WIDE_IN = 10.2
"""Width of the figure, inches."""

ROW_IN = 0.14
"""Height of a robot's or a unit's row, inches. Chosen: labels of 8 points just do not touch."""

MAX_ROWS_LABELLED = 24
"""Number of robots above which only every fifth row is labelled."""


def draw_topology(history: History) -> Figure:
    """Draw the units that control each robot, and the validity of TC1-TC5, over time.

    Every robot has a row in the colours of its units. With a tree of units, every unit has a row as well,
    filled while it belongs to the tree. A dashed line marks the instant at which the tree was complete.
    """
    robots, units = history.ids.size, history.controlled.shape[1]
    members = np.array([_in_tree(tree, units) for tree in history.trees])
    heights = [ROW_IN * robots, *([ROW_IN * units] if members.any() else []), 0.8]
    figure = new_figure(1.5 + sum(heights), WIDE_IN)
    rows = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    upper, lower = rows[0], rows[-1]
    edges_s = np.append(history.times_s, history.times_s[-1] + history.mission.scenario.step_s)
    _draw_control(upper, history, edges_s)
    if members.any():
        _draw_members(rows[1], members, edges_s)
    _draw_conditions(lower, history, edges_s)
    if members.any() and history.ready_row is not None:
        for axes in rows:
            axes.axvline(history.times_s[history.ready_row], color=INK, linestyle=(0, (3, 2)), linewidth=1)
    upper.set_xlim(edges_s[0], edges_s[-1])
    colors = {f"unit {unit}": unit_color(unit) for unit in range(history.controlled.shape[1])}
    colors |= {"holds": HOLDS, "violated": BROKEN}
    if required_conditions(history.mission) < 5:
        colors[f"does not hold: {NOT_REQUIRED}"] = SPARED
    handles: list[Artist] = [Patch(color=color, label=label) for label, color in colors.items()]
    if members.any():
        handles.append(Line2D([], [], color=INK, linestyle=(0, (3, 2)), linewidth=1, label="tree complete"))
    legend_above(figure, handles, columns=7)
    return figure


def _in_tree(tree: TreeSnapshot | None, units: int) -> BoolArray:
    """Return the units (U,) that belong to the tree."""
    return np.isin(np.arange(units), [] if tree is None else list(tree.members))


def _draw_members(axes: Axes, members: BoolArray, edges_s: Array) -> None:
    """Draw bars while a unit (T, U) belongs to the tree; it is dead or outside in between."""
    for unit, column in enumerate(members.T):
        for start, end in runs(column[:, None]):
            if column[start]:
                bar = _rectangle(left=edges_s[start], right=edges_s[end], bottom=unit - BAR / 2, height=BAR)
                axes.add_collection(PolyCollection([bar], facecolor=unit_color(unit), linewidth=0))
    axes.set_yticks(range(members.shape[1]), labels=[str(unit) for unit in range(members.shape[1])])
    _finish_rows(axes, members.shape[1])
    axes.set_ylabel("in the tree")


def _draw_control(axes: Axes, history: History, edges_s: Array) -> None:
    """Draw each robot's row, split between the units that control it; empty while none does."""
    bars: dict[int, list[Array]] = {}
    for row in range(history.ids.size):
        for start, end in runs(history.controlled[:, :, row]):
            units: list[int] = np.flatnonzero(history.controlled[start, :, row]).tolist()
            for share, unit in enumerate(units):
                height = BAR / len(units)
                bar = _rectangle(
                    left=edges_s[start],
                    right=edges_s[end],
                    bottom=row - BAR / 2 + share * height,
                    height=height,
                )
                bars.setdefault(unit, []).append(bar)
    for unit, rectangles in bars.items():
        axes.add_collection(PolyCollection(rectangles, facecolor=unit_color(unit), linewidth=0))
    every = 1 if history.ids.size <= MAX_ROWS_LABELLED else 5
    axes.set_yticks(range(0, history.ids.size, every), labels=[str(robot) for robot in history.ids[::every]])
    _finish_rows(axes, history.ids.size)
    axes.set_ylabel("robot")


def _draw_conditions(axes: Axes, history: History, edges_s: Array) -> None:
    required = required_conditions(history.mission)
    for row, holds in enumerate(history.conditions.T):
        for start, end in runs(holds[:, None]):
            bar = _rectangle(left=edges_s[start], right=edges_s[end], bottom=row - BAR / 2, height=BAR)
            color = HOLDS if holds[start] else BROKEN if row < required else SPARED
            axes.add_collection(PolyCollection([bar], facecolor=color, linewidth=0))
    axes.set_yticks(range(5), labels=[f"TC{row + 1}" for row in range(5)])
    _finish_rows(axes, 5)
    axes.set_xlabel("time (s)")


def _finish_rows(axes: Axes, rows: int) -> None:
    axes.set_ylim(rows - 0.4, -0.6)
    axes.tick_params(axis="y", length=0, labelsize=8)
    axes.grid(False, axis="y")
    axes.spines["left"].set_visible(False)


def runs(states: BoolArray) -> Iterator[tuple[int, int]]:
    """Return index ranges (start, end), end excluded, over which the rows of states (T, K) are constant."""
    changes = np.flatnonzero((states[1:] != states[:-1]).any(axis=1)) + 1
    bounds = [0, *changes.tolist(), len(states)]
    yield from pairwise(bounds)


def _rectangle(left: float, right: float, bottom: float, height: float) -> Array:
    return np.array([[left, bottom], [right, bottom], [right, bottom + height], [left, bottom + height]])
