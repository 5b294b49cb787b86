"""Figure of `skyherd track`: the tracks of each recording, and the shape error over time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from skyherd.drawing.palette import INK, MUTED, PAPER
from skyherd.geometry import Array
from skyherd.plots.style import (
    draw_line,
    drawing_style,
    frame_square,
    legend_above,
    new_figure,
    robot_colorbar,
    robot_colors,
    use_log_scale,
)
from skyherd.tracking.ground_tracks import GroundTracks, ShapeErrors

SIDE_IN, ERROR_IN = 3.4, 2.2
"""Side of a panel of tracks, and height of the panel of errors, inches."""

COLUMNS = 2
"""Maximum number of track panels in a row. Chosen: they fill a page's width."""

MAX_LABELS = 24
"""Maximum number of markers with a label at their last position; above it, a colour bar shows the ids."""

NAME_LENGTH = 40
"""Maximum number of characters of a recording's name over its panel."""

GAP_S = 1.0
"""Maximum gap of detections that a track bridges, s. Chosen: the path in a longer gap is unknown."""


def draw_tracks(recordings: Sequence[GroundTracks], errors: Sequence[ShapeErrors]) -> Figure:
    """Draw the tracks of recordings, one panel each, and below them the shape errors, if any.

    A track begins at a small square and ends at a circle with the marker's number. Errors of images with the
    whole team form a line; errors of fewer robots are pale dots.
    """
    shown = [tracks for tracks in recordings if tracks.ids.size] or list(recordings[:1])
    columns = min(len(shown), COLUMNS)
    rows = -(-len(shown) // columns)
    measured = any(np.isfinite(error.errors).any() for error in errors)
    heights = [SIDE_IN * (1.0 if columns > 1 else 1.5)] * rows + [ERROR_IN] * measured
    with drawing_style():
        figure = new_figure(sum(heights) + 0.3, width_in=7.2)
        grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
        panels = [figure.add_subplot(grid[k // columns, k % columns]) for k in range(len(shown))]
        ids = np.unique(np.concatenate([tracks.ids for tracks in shown]))
        colors = dict(zip(ids.tolist(), robot_colors(ids.size), strict=True))
        for axes, tracks in zip(panels, shown, strict=True):
            _draw_recording(axes, tracks, colors, titled=len(recordings) > 1, labelled=ids.size <= MAX_LABELS)
        if ids.size > MAX_LABELS:
            robot_colorbar(figure, panels, ids)
        if measured:
            _draw_errors(figure.add_subplot(grid[rows, :]), recordings, errors)
        handles = [
            Line2D([], [], color=INK, marker="s", linestyle="", markersize=4, label="first seen"),
            Line2D([], [], color=INK, marker="o", linestyle="", markersize=6, label="last seen"),
        ]
        if any((error.counts < error.team).any() for error in errors):
            few = "error of the robots in view, not all"
            handles.append(Line2D([], [], color=MUTED, marker=".", linestyle="", label=few))
        legend_above(figure, handles)
    return figure


def _draw_recording(
    axes: Axes, tracks: GroundTracks, colors: dict[int, Array], *, titled: bool, labelled: bool
) -> None:
    everything = []
    for marker in tracks.ids.tolist():
        times_s, path = tracks.path(marker)
        seen = np.flatnonzero(np.isfinite(path[:, 0]))
        pieces = np.split(seen, np.flatnonzero(np.diff(times_s[seen]) > GAP_S) + 1)
        color = colors[marker]
        for piece in pieces:
            axes.plot(*path[piece].T, color=color, linewidth=1.0)
        axes.plot(*path[seen[0]], "s", color=color, markersize=3.5)
        axes.plot(*path[seen[-1]], "o", color=color, markersize=12 if labelled else 6, markeredgecolor=PAPER)
        if labelled:
            axes.annotate(
                str(marker),
                path[seen[-1]],
                color=PAPER,
                ha="center",
                va="center_baseline",
                fontsize=7,
                zorder=9,
            )
        everything.append(path[seen])
    if everything:
        points = np.concatenate(everything)
        half = max(float(np.ptp(points, axis=0).max()), 2.0 * (tracks.side_m or 1.0)) * 0.55
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        frame_square(axes, np.array([middle - half, middle + half]))
    else:
        axes.text(
            0.5, 0.5, "no marker found", ha="center", va="center", transform=axes.transAxes, color=MUTED
        )
    axes.set(xlabel=f"x ({tracks.unit})", ylabel=f"y ({tracks.unit})")
    if titled:
        axes.set_title(tracks.name if len(tracks.name) <= NAME_LENGTH else f"{tracks.name[:NAME_LENGTH]}…")


def _draw_errors(axes: Axes, recordings: Sequence[GroundTracks], errors: Sequence[ShapeErrors]) -> None:
    grey = np.linspace(0.0, 0.6, max(len(recordings), 1))
    for shade, tracks, error in zip(grey, recordings, errors, strict=True):
        whole = error.counts == error.team
        color = INK if len(recordings) == 1 else str(shade)
        part = np.where(whole, np.nan, error.errors)
        axes.plot(error.times_s, 100 * part, ".", color=MUTED, markersize=2.5, alpha=0.5)
        line = np.where(whole, 100 * error.errors, np.nan)
        name = tracks.name if len(recordings) > 1 else ""
        draw_line(axes, error.times_s, line, color=color, linewidth=1.5, label=name)
    axes.set(xlabel="time (s)", ylabel="shape error (%), log")
    axes.margins(x=0)
    use_log_scale(axes)
    if len(recordings) > 1:
        axes.legend(loc="best")
