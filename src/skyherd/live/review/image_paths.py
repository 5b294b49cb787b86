"""Figure of the markers' paths and goals in the units' images."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from skyherd.drawing.palette import INK, PAPER
from skyherd.geometry import Array
from skyherd.live.review.process_history import ProcessHistory
from skyherd.live.review.session_history import SessionHistory
from skyherd.plots.style import frame_square, legend_above, new_figure, robot_colorbar, robot_colors

MAX_PANELS = 12
"""Largest number of units drawn. Chosen: more than a page shows well."""

MAX_POINTS = 1500
"""Largest number of points drawn per path. Chosen: above the width of a figure in pixels."""

GAP_S = 1.0
"""Time without the marker above which its path is interrupted, s. Chosen: the path in between is unknown."""

MAX_LABELS = 24
"""Largest number of robots with labels; with more robots, a colour bar identifies them."""


def draw_images(session: SessionHistory) -> Figure | None:
    """Draw the markers' paths in each unit's images, and the last goals. Return None without images."""
    units = [log for log in session.first_units() if any(run.seen for run in session.runs[log.name])]
    if not units:
        return None
    units = units[:MAX_PANELS]
    columns = min(len(units), 2)
    rows = -(-len(units) // columns)
    figure = new_figure((4.6 if columns == 1 else 3.2) * rows + 0.4)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    ids = np.array(session.lab.ids)
    colors = dict(zip(ids.tolist(), robot_colors(ids.size), strict=True))
    for axes, log in zip(panels, units, strict=False):
        _draw_image(axes, session.runs[log.name], colors)
        axes.set_title(log.name)
    for axes in panels[len(units) :]:
        axes.set_visible(False)
    if ids.size > MAX_LABELS:
        robot_colorbar(figure, list(panels), ids)
    handles = [
        Line2D([], [], color=INK, marker="s", linestyle="", markersize=4, label="first seen"),
        Line2D([], [], color=INK, marker="o", linestyle="", markersize=6, label="last seen"),
        Line2D([], [], color=INK, marker="+", linestyle="", markersize=9, label="last goal"),
    ]
    legend_above(figure, handles)
    return figure


def _draw_image(axes: Axes, logs: list[ProcessHistory], colors: dict[int, Array]) -> None:
    images = [seen for log in logs for seen in log.seen]
    width, height = next(log.image_size_px for log in reversed(logs) if log.seen)
    all_ids = np.concatenate([seen.ids for seen in images])
    all_points = np.concatenate([seen.centers_px for seen in images])
    all_times_s = np.repeat([seen.time_s for seen in images], [seen.ids.size for seen in images])
    for robot, color in colors.items():
        rows = np.flatnonzero(all_ids == robot)
        if not rows.size:
            continue
        rows = rows[:: -(-rows.size // MAX_POINTS)]
        for piece in np.split(rows, np.flatnonzero(np.diff(all_times_s[rows]) > GAP_S) + 1):
            axes.plot(*all_points[piece].T, color=color, linewidth=1.0)
        first, last = all_points[rows[0]], all_points[rows[-1]]
        labelled = len(colors) <= MAX_LABELS
        axes.plot(*first, "s", color=color, markersize=3.5)
        axes.plot(*last, "o", color=color, markersize=11 if labelled else 6, markeredgecolor=PAPER)
        if labelled:
            axes.annotate(
                str(robot), last, color=PAPER, ha="center", va="center_baseline", fontsize=7, zorder=9
            )
    for robot, place in logs[-1].goals_px.items():
        axes.plot(*place, "+", color=colors.get(robot, INK), markersize=17)
    frame_square(axes, np.array([[0.0, 0.0], [width, height]]))
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="u (px)", ylabel="v (px)")
