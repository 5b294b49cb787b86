"""Paths of the robots on one task: a panel per method, all from the same start."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from skyherd.drawing.palette import INK, MUTED
from skyherd.geometry import Array
from skyherd.plots.style import new_figure, plain, robot_colors
from skyherd.study.methods.outcomes import Method, Outcomes

COLUMNS = 5
"""Maximum number of panels in a row. Chosen: with seven, single paths are not visible; with three, the figure
of ten methods is higher than a screen."""

MAX_ZOOM = 2.2
"""Maximum ratio of the frame's half width to the distance of the farthest start from its middle. Chosen:
twice the start shows nearly all paths in full; a divergent method would make the others' tiny."""


def draw_paths(task: str, methods: Sequence[Method], bodies: Mapping[str, Any]) -> Figure | None:
    """Draw the paths of all robots from the first start of a task, a panel per method, in one frame.

    Small dots are starts, circles the bodies at the end, grey discs obstacles.

    Args:
        task: name of the task.
        methods: methods of the study.
        bodies: `radius_m` of robots, and `obstacles` as (x, y, radius), all in m.

    Returns:
        None if no method has a run.
    """
    shown = [
        (method.name, runs, runs.waypoints_m)
        for method in methods
        if (runs := method.outcomes[task]).waypoints_m is not None
    ]
    if not shown:
        return None
    columns = min(len(shown), COLUMNS)
    rows = -(-len(shown) // columns)
    figure = new_figure(2.75 * rows + 0.3, 2.45 * columns)
    panels = figure.subplots(rows, columns, squeeze=False)
    middle, reach = _frame([places for _, _, places in shown])
    for axes, (name, runs, places) in zip(panels.flat, shown, strict=False):
        _draw_ways(axes, places, bodies)
        axes.set_title(f"{plain(name)}\n{_result(runs)}", fontsize="small")
        axes.set_xlim(middle[0] - reach, middle[0] + reach)
        axes.set_ylim(middle[1] - reach, middle[1] + reach)
    for axes in panels.flat:
        axes.set_aspect("equal")
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_axis_off()
    _draw_scale(panels.flat[0], middle, reach)
    return figure


def _frame(all_places: Sequence[Array]) -> tuple[Array, float]:
    """Return centre (2,) and half width of a frame for all paths, or for the start if some diverge."""
    start = all_places[0][0]
    middle = (start.min(axis=0) + start.max(axis=0)) / 2
    most = max(float(np.abs(places - middle).max()) for places in all_places)
    return middle, 1.1 * min(most, MAX_ZOOM * float(np.abs(start - middle).max()))


def _draw_ways(axes: Axes, places: Array, bodies: Mapping[str, Any]) -> None:
    for x, y, radius in bodies["obstacles"]:
        axes.add_patch(Circle((x, y), radius, facecolor="#d0d4d9", edgecolor=MUTED, linewidth=0.6))
    for robot, color in enumerate(robot_colors(places.shape[1])):
        way = places[:, robot]
        axes.plot(*way.T, color=color, linewidth=0.9)
        axes.plot(*way[0], marker="o", markersize=2.2, color=color)
        radius = max(bodies["radius_m"], 0.05)
        axes.add_patch(Circle(way[-1], radius, fill=False, edgecolor=INK, linewidth=0.7))


def _result(runs: Outcomes) -> str:
    """Describe the outcome of the first run in a few words."""
    if runs.converged[0]:
        said = f"formed in {runs.times_s[0]:.0f} s"
    elif runs.affine[0]:
        said = f"affine image in {runs.affine_times_s[0]:.0f} s"
    else:
        said = f"not formed, {100 * runs.errors[0]:.2g} % off"
    return f"{said}, collided" if runs.collided[0] else said


def _draw_scale(axes: Axes, middle: Array, reach: float) -> None:
    """Draw a bar of one metre, in the lower left corner, below the bodies."""
    left, low = middle - reach
    axes.plot([left, left + 1.0], [low, low], color=INK, linewidth=1.6, clip_on=False)
    axes.text(left + 0.5, low - 0.03 * reach, "1 m", ha="center", va="top", fontsize="x-small", color=INK)
