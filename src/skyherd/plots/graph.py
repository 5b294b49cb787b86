"""Figure of the topology as a graph: units, the robots that each controls, and shared pairs."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from skyherd.analysis.history import History
from skyherd.control import ControlSets, graph_edges, owners_by_robot
from skyherd.drawing.palette import INK, MUTED, PAPER, unit_color
from skyherd.geometry import Array, IntArray
from skyherd.plots.style import frame_square, legend_above, new_figure

SIDE_IN = 7.2
"""Width and height of the figure, inches."""

UNIT_SIZE, ROBOT_SIZE = 300, 110
"""Areas of the markers of units and of robots, square points, as Matplotlib's `scatter` expects them."""

MAX_LABELS = 120
"""Maximum number of robots with labelled ids. Chosen: more labels overlap."""


def draw_graph(history: History) -> Figure:
    """Draw the final topology of a run on the ground, without units in an outage."""
    last = history.controlled[-1]
    sets = {unit: history.ids[mine] for unit, mine in enumerate(last) if unit not in _dead(history)}
    figure = new_figure(SIDE_IN, SIDE_IN)
    axes = figure.subplots()
    draw_sets(axes, sets, history.ids, history.positions_m[-1], history.unit_positions_m[-1])
    legend_above(figure, graph_handles(), columns=4)
    return figure


def _dead(history: History) -> frozenset[int]:
    """Return the units that are in an outage at the end."""
    tree = history.trees[-1]
    return frozenset() if tree is None else tree.dead


def graph_handles() -> list[Line2D]:
    """Return the legend entries of a graph: a unit, an edge, a robot."""
    unit: dict[str, Any] = {"ls": "", "marker": "s", "mfc": MUTED, "mec": PAPER, "ms": 11}
    robot: dict[str, Any] = {"ls": "", "marker": "o", "mfc": PAPER, "mec": unit_color(0), "mew": 2}
    return [
        Line2D([], [], label="unit", **unit),
        Line2D([], [], color=INK, lw=3, label="edge: two or more shared robots"),
        Line2D([], [], label="robot", ms=8, **robot),
    ]


def draw_sets(axes: Axes, sets: ControlSets, ids: IntArray, robots_m: Array, units_m: Array) -> None:
    """Draw robots and units on the ground, and the control sets.

    Args:
        axes: in metres; they are framed to show everything.
        sets: robots controlled by each unit, by unit.
        ids: (N,) all robots, ascending.
        robots_m: (N, 2) their positions.
        units_m: (U, 2) the units' positions, a row for each unit of the mission.
    """
    for unit, mine in sets.items():
        spokes = robots_m[np.searchsorted(ids, mine)]
        for x, y in spokes.tolist():
            line = [units_m[unit, 0], x], [units_m[unit, 1], y]
            axes.plot(*line, color=unit_color(unit), lw=0.7, alpha=0.55, zorder=1)
    for j, k in graph_edges(sets):
        ends = units_m[[j, k]]
        axes.plot(*ends.T, color=INK, lw=3, zorder=2, solid_capstyle="round")
    owners = owners_by_robot(sets)
    for robot, place in zip(ids.tolist(), robots_m, strict=True):
        _draw_robot(axes, robot, place, owners.get(robot, []), named=ids.size <= MAX_LABELS)
    for unit in sets:
        x, y = units_m[unit].tolist()
        color = unit_color(unit)
        axes.scatter(x, y, s=UNIT_SIZE, c=color, marker="s", edgecolor=PAPER, linewidth=1.5, zorder=5)
        name = axes.annotate(str(unit), (x, y), ha="center", va="center", zorder=6, weight="bold")
        name.set_path_effects([withStroke(linewidth=2.5, foreground=PAPER)])
    frame_square(axes, np.concatenate([robots_m, units_m]))
    axes.set(xlabel="x (m)", ylabel="y (m)")


def _draw_robot(axes: Axes, robot: int, place: Array, owners: list[int], *, named: bool) -> None:
    """Draw a ring in the colour of each controlling unit, nested; grey without a unit."""
    x, y = place.tolist()
    colors = [unit_color(unit) for unit in owners] or [MUTED]
    for k, color in reversed(list(enumerate(colors))):
        size = ROBOT_SIZE * (1 + 0.75 * k)
        axes.scatter(x, y, s=size, facecolor=PAPER, edgecolor=color, linewidth=2, zorder=3)
    if named:
        axes.annotate(str(robot), (x, y), ha="center", va="center", fontsize=6, zorder=4)
