"""The panels of the paper's two simulation figures, in the paper's order, drawn from our runs.

`benchmarks/paper_figures.py` makes the runs. Published numbers are dotted lines or crosses.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

from skyherd.analysis.history import History
from skyherd.drawing.palette import INK, MUTED, PAPER, TEMPLATE_COLOR, WARNING, unit_color
from skyherd.geometry import Array, ComplexArray, IntArray, to_complex
from skyherd.plots.curves import camera_speeds_mps, unwrap
from skyherd.plots.style import drawing_style, robot_colors, use_log_scale

DPI = 90
COLORS = 128
"""Number of colours of a picture's palette. Chosen: files are a third as large, and lines look the same."""

PUBLISHED: dict[str, Any] = {"color": WARNING, "linestyle": ":", "linewidth": 1.3}
"""Style of published values."""


def figure4(history: History, published: dict[str, Any], path: Path) -> None:
    """Draw the one-camera figure of five rows; the first shows the ground."""
    with drawing_style():
        figure = Figure(figsize=(9.6, 14.0), layout="constrained")
        grid = figure.add_gridspec(5, 2, height_ratios=[1.9, 1, 1.35, 1, 1])
        ground = figure.add_subplot(grid[0, :])
        panels = [[figure.add_subplot(grid[row, column]) for column in (0, 1)] for row in range(1, 5)]
        draw_ground(ground, history)
        ends = np.array(published["final_positions_m"])
        ground.plot(*ends.T, "x", color=WARNING, markersize=9, zorder=7, label="published ends")
        ground.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0))
        draw_velocities(panels[0], history)
        panels[0][0].axhline(published["speed_below_mps"], **PUBLISHED)
        panels[0][0].axhline(-published["speed_below_mps"], **PUBLISHED)
        draw_trace(panels[1][0], history, 0)
        draw_cost(panels[1][1], history, published["V_start_m2"])
        panels[1][1].axvline(published["formed_s"], **PUBLISHED)
        draw_fits(panels[2], history)
        panels[2][0].axhline(published["final_scale"], **PUBLISHED)
        draw_units(panels[3][0], history.times_s, history.heights_m, "camera height (m)")
        for at, height_m in zip((0, -1), published["camera_heights_m"], strict=True):
            panels[3][0].plot(history.times_s[at], height_m, "x", color=WARNING, markersize=9, clip_on=False)
        yaws_deg = np.degrees(np.apply_along_axis(unwrap, 0, history.yaws_rad))
        draw_units(panels[3][1], history.times_s, yaws_deg, "camera rotation (°)")
        turn = [0.0, published["camera_turn_deg"]]
        panels[3][1].plot([0.0, published["turn_s"]], turn, "x", color=WARNING, markersize=9, clip_on=False)
        save(figure, path)


def figure5(history: History, published: dict[str, Any], path: Path) -> None:
    """Draw the three-camera figure: ground and four curves, images, three curves."""
    with drawing_style():
        figure = Figure(figsize=(13.0, 13.0), layout="constrained")
        rows = figure.subfigures(3, 1, height_ratios=[1.9, 1.2, 1])
        top = rows[0].add_gridspec(2, 3, width_ratios=[1.7, 1, 1])
        draw_ground(rows[0].add_subplot(top[:, 0]), history)
        curves = [[rows[0].add_subplot(top[row, column]) for column in (1, 2)] for row in (0, 1)]
        draw_velocities(curves[0], history)
        draw_fits(curves[1], history)
        images = list(rows[1].subplots(1, 4))
        draw_template(images[0], history)
        for unit, axes in enumerate(images[1:]):
            draw_trace(axes, history, unit)
        cost, heights, speeds = rows[2].subplots(1, 3)
        draw_cost(cost, history, published["V_start_m2"])
        draw_units(heights, history.times_s, history.heights_m, "camera height (m)")
        heights.plot(
            [0.0] * 3, published["camera_heights_m"], "x", color=WARNING, markersize=9, clip_on=False
        )
        heights.axhline(published["settled_height_m"], **PUBLISHED)
        heights.set_ylim(bottom=0.0)
        draw_units(speeds, history.times_s[1:], camera_speeds_mps(history), "camera speed (m/s)")
        speeds.legend(loc="upper right")
        save(figure, path)


def draw_ground(axes: Axes, history: History) -> None:
    """Draw paths of robots and cameras, the final formation dashed, and the final fields of view."""
    places = to_complex(history.positions_m)
    lines = axes.plot(places.real, places.imag, color=INK, alpha=0.45, linewidth=0.9)
    lines[0].set_label("robots")
    axes.plot(places[0].real, places[0].imag, "s", color=INK, markersize=3.5, markerfacecolor=PAPER)
    draw_outline(axes, places[-1], history, INK)
    for unit in range(history.heights_m.shape[1]):
        color, way_m = unit_color(unit), history.unit_positions_m[:, unit]
        axes.plot(*way_m.T, color=color, linewidth=1.8, label="camera, and what it sees at the end")
        axes.plot(*way_m[0], "s", color=color, markersize=8)
        axes.plot(*way_m[-1], "o", color=color, markersize=9, markeredgecolor=PAPER, zorder=6)
        half_rad = np.radians(history.mission.scenario.units[unit].camera.half_angle_deg)
        radius_m = float(history.heights_m[-1, unit] * np.tan(half_rad))
        axes.add_patch(Circle(tuple(way_m[-1]), radius_m, fill=False, color=color, linewidth=1.0))
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    axes.autoscale_view()


def draw_velocities(pair: list[Axes], history: History) -> None:
    """Draw forward speeds and turn rates of all robots."""
    told = (history.v_mps, "linear velocity (m/s)"), (history.omega_radps, "angular velocity (rad/s)")
    for axes, (values, label) in zip(pair, told, strict=True):
        for column, color in zip(values.T, robot_colors(history.ids.size), strict=True):
            axes.plot(history.times_s, column, color=color, linewidth=0.9)
        over_time(axes, label)


def draw_fits(pair: list[Axes], history: History) -> None:
    """Draw scale and rotation of each unit's part of the formation."""
    draw_units(pair[0], history.times_s, history.scales, "scale (m / template unit)")
    whole = unwrap(history.shape_rotation_rad)
    parts = whole[:, None] + np.angle(np.exp(1j * (history.rotations_rad - whole[:, None])))
    draw_units(pair[1], history.times_s, np.degrees(parts), "rotation (°)")


def draw_cost(axes: Axes, history: History, published_m2: float) -> None:
    """Draw V and each unit's share on a logarithmic axis; the cross is the published V."""
    axes.plot(history.times_s, history.V, color=INK, linewidth=2.2, label="V")
    if history.V_units.shape[1] > 1:
        for unit, column in enumerate(history.V_units.T):
            axes.plot(history.times_s, column, color=unit_color(unit), label=f"unit {unit}")
        axes.legend(loc="upper right")
    use_log_scale(axes)
    axes.set_ylim(bottom=max(axes.get_ylim()[0], 1e-7 * published_m2), top=2.5 * published_m2)
    axes.plot(0.0, published_m2, "x", color=WARNING, markersize=9, clip_on=False, zorder=7)
    over_time(axes, "V (m²)")


def draw_trace(axes: Axes, history: History, unit: int) -> None:
    """Draw image paths of the robots that a unit controlled: squares at the start, circles at the end."""
    width, height = history.mission.scenario.units[unit].camera.size_px
    points, color = history.traces[unit].points_px, unit_color(unit)
    axes.plot(points.real, points.imag, color=color, linewidth=0.9, alpha=0.6)
    first = points[int(np.argmax(np.isfinite(points).any(axis=1)))]
    axes.plot(first.real, first.imag, "s", color=color, markersize=4, markerfacecolor=PAPER)
    draw_outline(axes, first, history, MUTED, marks=False)
    draw_outline(axes, points[-1], history, color)
    limits = {"xlim": (-0.5, width - 0.5), "ylim": (height - 0.5, -0.5)}
    axes.set(aspect="equal", xlabel="u (px)", ylabel="v (px), down" if unit == 0 else "", **limits)
    axes.set_title(f"image of unit {unit}" if len(history.traces) > 1 else "image")
    axes.spines[["top", "right"]].set_visible(True)
    axes.grid(False)


def draw_template(axes: Axes, history: History) -> None:
    """Draw the desired shape as an image."""
    draw_outline(axes, history.shape.points_of(history.ids), history, TEMPLATE_COLOR)
    axes.set(aspect="equal", title="template", xlabel="u (template units)")
    axes.invert_yaxis()


def formation_order(points: ComplexArray) -> IntArray:
    """Return the order (N,) that joins points (N,) into a closed outline, by angle about their mean.

    No two sides of the outline cross: the mean lies among the points, so that neighbours in this order are
    less than half a turn apart.
    """
    return np.argsort(np.angle(points - points.mean()), kind="stable")


def draw_outline(
    axes: Axes, points: ComplexArray, history: History, color: str, *, marks: bool = True
) -> None:
    """Join points (N,) of the present robots in the order that outlines their part of the shape."""
    there = np.isfinite(points)
    order = np.flatnonzero(there)[formation_order(history.shape.points_of(history.ids)[there])]
    closed = points[np.append(order, order[:1])]
    axes.plot(closed.real, closed.imag, color=color, linestyle=(0, (4, 3)), linewidth=0.9)
    if marks:
        axes.plot(closed.real, closed.imag, "o", color=color, markersize=5, markerfacecolor=PAPER, zorder=5)


def draw_units(axes: Axes, times_s: Array, values: Array, label: str) -> None:
    """Draw values (T, U) over time, each unit in its colour."""
    for unit, column in enumerate(values.T):
        axes.plot(times_s, column, color=unit_color(unit), label=f"unit {unit}")
    over_time(axes, label)


def over_time(axes: Axes, label: str) -> None:
    """Label the axes, without margins before the first and after the last instant."""
    axes.set(xlabel="time (s)", title=label)
    axes.set_xlim(0.0, max(float(np.max(line.get_xdata())) for line in axes.lines))


def save(figure: Figure, path: Path) -> None:
    """Write a PNG with a palette of `COLORS`."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    palette = picture.quantize(COLORS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    palette.save(path, optimize=True)
