"""Figures over time: velocities, cost, scales, rotations, heights, and the shape error."""

import numpy as np
from matplotlib.figure import Figure

from skyherd.analysis.history import History
from skyherd.drawing.palette import INK, MUTED
from skyherd.geometry import Array, wrap_angle
from skyherd.plots.style import (
    draw_line,
    draw_unit_lines,
    legend_above,
    new_figure,
    robot_colorbar,
    robot_colors,
    time_axes,
    use_log_scale,
)

ONE_ROW_IN = 3.2
"""Height of a figure of one panel, inches."""

TWO_ROWS_IN = 5.0
"""Height of a figure of two panels, one below the other, inches."""


def draw_robot_velocities(history: History) -> Figure:
    """Draw the forward speed, m/s, and the turn rate, rad/s, commanded to each robot's wheels."""
    figure = new_figure(TWO_ROWS_IN)
    axes = time_axes(figure, ["forward speed v (m/s)", "turn rate ω (rad/s)"])
    colors = robot_colors(history.ids.size)
    for ax, values in zip(axes, (history.v_mps, history.omega_radps), strict=True):
        ax.axhline(0.0, color=MUTED, linewidth=0.8)
        for robot, color in enumerate(colors):
            draw_line(ax, history.times_s, values[:, robot], color=color, linewidth=1.0)
    robot_colorbar(figure, axes, history.ids)
    return figure


def draw_cost(history: History) -> Figure:
    """Draw the Lyapunov function V = Σ_j V^j and each unit's share V^j, m², on linear and log axes.

    V^j is half the sum of the squared distances of unit j's robots to their desired points (the paper's eq.
    9).
    """
    figure = new_figure(TWO_ROWS_IN)
    axes = time_axes(figure, ["V (m²)", "V (m²), log"])
    for ax in axes:
        draw_line(ax, history.times_s, history.V, color=INK, linewidth=2.4, label="V, all units")
        draw_unit_lines(ax, history.times_s, history.V_units)
    axes[0].set_ylim(bottom=0.0)
    use_log_scale(axes[1])
    legend_above(figure)
    return figure


def draw_scales(history: History) -> Figure:
    """Draw the scale, m per template unit, of the best-fitting shape of each unit's robots, and of all."""
    figure = new_figure(ONE_ROW_IN)
    (axes,) = time_axes(figure, ["scale (m per template unit)"])
    draw_unit_lines(axes, history.times_s, history.scales)
    _draw_whole(figure, history, history.shape_scale)
    return figure


def draw_rotations(history: History) -> Figure:
    """Draw the rotation, degrees, of the best-fitting shape of each unit's robots, and of all robots."""
    figure = new_figure(ONE_ROW_IN)
    (axes,) = time_axes(figure, ["rotation (°)"])
    whole = unwrap(history.shape_rotation_rad)
    partial = whole[:, None] + wrap_angle(history.rotations_rad - whole[:, None])
    draw_unit_lines(axes, history.times_s, np.degrees(partial))
    _draw_whole(figure, history, np.degrees(whole))
    return figure


def draw_heights(history: History) -> Figure:
    """Draw the height of each camera, m, and varying zoom factors in a second panel."""
    zooming = bool((np.ptp(history.zooms, axis=0) > 0).any())
    figure = new_figure(TWO_ROWS_IN if zooming else ONE_ROW_IN)
    axes = time_axes(figure, ["height (m)", "zoom factor"] if zooming else ["height (m)"])
    draw_unit_lines(axes[0], history.times_s, history.heights_m)
    if zooming:
        draw_unit_lines(axes[1], history.times_s, history.zooms)
    legend_above(figure)
    return figure


def draw_yaws(history: History) -> Figure:
    """Draw the yaw of each camera, degrees, unwrapped, counter-clockwise seen from above."""
    figure = new_figure(ONE_ROW_IN)
    (axes,) = time_axes(figure, ["camera yaw (°)"])
    yaws_rad = np.apply_along_axis(unwrap, 0, history.yaws_rad)
    draw_unit_lines(axes, history.times_s, np.degrees(yaws_rad))
    legend_above(figure)
    return figure


def draw_camera_speeds(history: History) -> Figure:
    """Draw the speed of each camera in space, m/s, horizontal and vertical motion combined."""
    figure = new_figure(ONE_ROW_IN)
    (axes,) = time_axes(figure, ["camera speed (m/s)"])
    draw_unit_lines(axes, history.times_s[1:], camera_speeds_mps(history))
    axes.set_ylim(bottom=0.0)
    if history.times_s.size > 1:
        axes.set_xlim(left=history.times_s[0])
    legend_above(figure)
    return figure


def draw_shape_error(history: History) -> Figure:
    """Draw the shape error, per cent of the formation's RMS radius, and the goal's threshold."""
    figure = new_figure(ONE_ROW_IN)
    (axes,) = time_axes(figure, ["shape error (%), log"])
    goal = 100 * history.mission.scenario.goal.shape_error
    axes.axhline(goal, color=MUTED, linestyle="--", linewidth=1.2, label=f"goal {goal:g} %")
    draw_line(axes, history.times_s, 100 * history.shape_error, color=INK, linewidth=1.8, label="shape error")
    use_log_scale(axes)
    legend_above(figure)
    return figure


def camera_speeds_mps(history: History) -> Array:
    """Return the camera speeds (T - 1, U), m/s, by differences of position and height."""
    points_m = np.concatenate([history.unit_positions_m, history.heights_m[..., None]], axis=-1)
    moved_m = np.linalg.norm(np.diff(points_m, axis=0), axis=-1)
    return np.asarray(moved_m / np.diff(history.times_s)[:, None])


def unwrap(angles_rad: Array) -> Array:
    """Unwrap angles (T,), rad; NaN values stay and do not affect the others."""
    smooth_rad = angles_rad.copy()
    known = np.isfinite(angles_rad)
    smooth_rad[known] = np.unwrap(angles_rad[known])
    return smooth_rad


def _draw_whole(figure: Figure, history: History, values: Array) -> None:
    """Draw the whole formation's value over the units' lines, and the legend."""
    draw_line(figure.axes[0], history.times_s, values, color=INK, linestyle="--", label="all robots")
    legend_above(figure)
