"""Figures of positions: paths on the ground, traces in the images, and the template."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon

from skyherd.analysis.history import History
from skyherd.control import fit_similarity
from skyherd.drawing.palette import INK, MUTED, PAPER, TEMPLATE_COLOR, unit_color
from skyherd.errors import DegenerateSetError
from skyherd.geometry import Array, ComplexArray, IntArray, apply_homography, to_complex, to_points
from skyherd.plots.style import frame_square, legend_above, new_figure, unit_handles
from skyherd.render import footprint_m, homography_image_ground, project

MAX_LABELS = 60
"""Maximum number of robots with labelled ids in a figure. Chosen: more labels overlap."""

STONE: dict[str, Any] = {"facecolor": "#e3e5e8", "edgecolor": INK, "linewidth": 0.9, "hatch": "///"}
"""Matplotlib style of an obstacle: grey and hatched."""

TRACE_SIDE_IN = {1: 4.8, 2: 4.0, 3: 3.4}
"""Side of a camera image's panel, inches, by the number of panels in a row. Chosen: a row fills the page."""

NEAR = 1.2
"""Limit of traces, in halves of the image's sides from its centre, without lens distortion. Chosen: a lens
model may fold far beyond the border."""

FAR = 1.5
"""Limit of shown fields of view, in multiples of the extent of all paths. Chosen: a strongly tilted camera
sees distant ground; with twice as much the paths would shrink to a spot."""


def draw_paths(history: History) -> Figure:
    """Draw ground paths of robots and cameras, m, and the final fields of view.

    Robots start at small squares and end at numbered circles, over the lines of the best-fitting shape.
    Obstacles and bodies are drawn if the mission has any.
    """
    figure = new_figure(7.1, 6.8)
    axes = figure.subplots()
    positions = to_complex(history.positions_m)
    axes.plot(positions.real, positions.imag, color=INK, alpha=0.45, linewidth=0.9)
    _draw_starts(axes, positions[0], INK)
    footprints = [_footprint_m(history, unit) for unit in range(history.heights_m.shape[1])]
    for unit, corners_m in enumerate(footprints):
        color, path_m = unit_color(unit), history.unit_positions_m[:, unit]
        axes.add_patch(Polygon(corners_m, facecolor="none", edgecolor=color, linewidth=1.1, alpha=0.8))
        axes.plot(*path_m.T, color=color, linewidth=1.8)
        axes.plot(*path_m[0], "s", color=color, markersize=7)
        axes.plot(*path_m[-1], "o", color=color, markersize=8, markeredgecolor=PAPER, zorder=6)
    _draw_bodies(axes, history)
    _draw_lines(axes, _fitted_lines(history, _shape_of(history, -1).conj(), positions[-1]))
    _draw_robots(axes, positions[-1], history.ids, INK)
    _frame_ground(axes, history, footprints)
    axes.set(xlabel="x (m)", ylabel="y (m)")
    shape = [Line2D([], [], color=TEMPLATE_COLOR, label="shape")] if _lines_of(history) else []
    handles = [*_start_and_end(INK), *shape, *unit_handles(len(footprints)), *_obstacle_handles(history)]
    legend_above(figure, handles, columns=7)
    return figure


def draw_image_traces(history: History) -> Figure:
    """Draw for each unit the ground paths of the robots that it controlled, px, as its last image shows them.

    The frame is that of the last image, so that a moving camera adds nothing to the paths. Two circles about
    the image centre show the safety radius, inside which a unit takes control of a robot, and the leaving
    radius, beyond which it may release the robot.
    """
    units = len(history.traces)
    columns = min(units, 3)
    rows = -(-units // columns)
    side_in = TRACE_SIDE_IN[columns]
    figure = new_figure(rows * (side_in + 0.1) + 0.7, columns * side_in + 0.3)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for unit, axes in enumerate(panels[:units]):
        _draw_trace(axes, history, unit)
        axes.set_xlabel("u (px)" if unit + columns >= units else "")
        axes.set_ylabel("v (px), down" if unit % columns == 0 else "")
    for axes in panels[units:]:
        axes.set_visible(False)
    radius = Line2D([], [], color=MUTED, linewidth=1.0, label="safety radius")
    leaving = Line2D([], [], color=MUTED, linewidth=1.0, linestyle=":", label="leaving radius")
    legend_above(figure, [*_start_and_end(INK), radius, leaving])
    return figure


def draw_template(history: History) -> Figure:
    """Draw the desired shape as points of the template image; the last one of several."""
    figure = new_figure(4.8, 5.2)
    axes = figure.subplots()
    points = history.shape.points_of(history.ids)
    _draw_lines(axes, _lines_of(history))
    _draw_robots(axes, points, history.ids, TEMPLATE_COLOR)
    axes.set(xlabel="u (template units)", ylabel="v (template units), down")
    frame_square(axes, to_points(points))
    axes.invert_yaxis()
    return figure


def still_traces(history: History, unit: int) -> ComplexArray:
    """Return the paths (T, N), px, of a unit's robots in the frame of its last image, as `u + iv`.

    NaN while the unit does not control a robot, and where the last image does not show its place.
    """
    camera = history.mission.cameras_at(float(history.times_s[-1]))[unit]
    pose = history.fleet(-1).pose(unit)
    places_m = history.positions_m
    matrix = homography_image_ground(camera, pose)
    flat_px = apply_homography(matrix, places_m)
    ahead = places_m @ matrix[2, :2] + matrix[2, 2] > 0
    near = ahead & (np.abs(centred_px(flat_px, camera.size_px)) <= NEAR).all(axis=-1)
    shown = near & history.controlled[:, unit]
    points_px = np.full(shown.shape, np.nan + 1j * np.nan)
    points_px[shown] = to_complex(project(camera, pose, places_m[shown]))
    return points_px


def centred_px(points_px: Array, size_px: tuple[int, int]) -> Array:
    """Return points (..., 2) relative to the image centre, in halves of the image's width and height."""
    half = np.array(size_px) / 2
    return np.asarray((points_px - half + 0.5) / half)


def _draw_trace(axes: Axes, history: History, unit: int) -> None:
    """Draw one unit's image: traces of its robots, their start and end, and its safety radius."""
    width, height = history.mission.scenario.units[unit].camera.size_px
    _draw_safety_radius(axes, history, width, height)
    points = still_traces(history, unit)
    color = unit_color(unit)
    axes.plot(points.real, points.imag, color=color, linewidth=0.9, alpha=0.6)
    if len(points):
        known = np.isfinite(points)
        first = known.argmax(axis=0)
        mine = np.flatnonzero(known.any(axis=0))
        _draw_starts(axes, points[first[mine], mine], color)
        held = mine[known[-1, mine]]
        _draw_robots(axes, points[-1, held], history.ids[held], color, size=8.5)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", title=f"unit {unit}")
    axes.locator_params(nbins=4)
    axes.spines[["top", "right"]].set_visible(True)
    axes.grid(False)


def _draw_safety_radius(axes: Axes, history: History, width: int, height: int) -> None:
    rule = history.mission.scenario.selection
    radius_px = rule.radius * min(width, height) / 2
    center = ((width - 1) / 2, (height - 1) / 2)
    for factor, line in ((1.0, "-"), (1.0 + rule.hysteresis, ":")):
        circle = Circle(center, radius_px * factor, fill=False, color=MUTED, linestyle=line, linewidth=1.0)
        axes.add_patch(circle)


def _draw_starts(axes: Axes, points: ComplexArray, color: str) -> None:
    axes.plot(points.real, points.imag, "s", color=color, markersize=4, markerfacecolor=PAPER)


def _draw_robots(axes: Axes, points: ComplexArray, ids: IntArray, color: str, *, size: float = 10.0) -> None:
    """Draw robots at points (N,) as circles, with their ids (N,) if these are few."""
    axes.plot(points.real, points.imag, "o", color=color, markersize=size, markerfacecolor=PAPER, zorder=4)
    if ids.size > MAX_LABELS:
        return
    for robot, point in zip(ids, points, strict=True):
        label = axes.text(point.real, point.imag, str(robot), fontsize=0.62 * size, zorder=5, clip_on=True)
        label.set(ha="center", va="center_baseline")


def _draw_lines(axes: Axes, lines: Sequence[ComplexArray]) -> None:
    """Draw the lines (M,) of the shape, each a stroke of its own."""
    for line in lines:
        axes.plot(line.real, line.imag, color=TEMPLATE_COLOR, linewidth=1.8, alpha=0.8, zorder=3)


def _lines_of(history: History) -> tuple[ComplexArray, ...]:
    """Return the lines of the last shape in image sense."""
    return history.mission.outline_at(float(history.times_s[-1]))


def _fitted_lines(history: History, shape: ComplexArray, points: ComplexArray) -> list[ComplexArray]:
    """Return the lines of the last shape, whose points (N,) are fitted to points (N,).

    Args:
        history: the run.
        shape: template points of the robots, y up.
        points: places of the robots, y up.
    """
    try:
        fit = fit_similarity(shape, points)
    except DegenerateSetError:
        return []
    return [fit(line.conj()) for line in _lines_of(history)]


def _shape_of(history: History, row: int) -> ComplexArray:
    """Return the template points (N,) assigned to the robots at a step."""
    shape = history.mission.shape_at(float(history.times_s[row]), history.roles[row])
    return shape.points_of(history.ids)


def _draw_bodies(axes: Axes, history: History) -> None:
    """Draw obstacles, and the robots' bodies at the end."""
    mission = history.mission
    for place, radius_m in zip(mission.obstacle_positions_m, mission.obstacle_radii_m, strict=True):
        axes.add_patch(Circle(place, radius_m, **STONE))
    if radius_m := mission.bodies.radius_m:
        for place in history.positions_m[-1]:
            axes.add_patch(Circle(place, radius_m, facecolor=MUTED, alpha=0.25, linewidth=0))


def _obstacle_handles(history: History) -> list[Patch]:
    return [Patch(**STONE, label="obstacle")] if history.mission.obstacle_ids.size else []


def _start_and_end(color: str) -> list[Line2D]:
    start = Line2D([], [], color=color, linestyle="", marker="s", markersize=4, label="start")
    end = Line2D([], [], color=color, linestyle="", marker="o", markersize=8, label="end")
    for handle in (start, end):
        handle.set_markerfacecolor(PAPER)
    return [start, end]


def _footprint_m(history: History, unit: int) -> Array:
    """Return the ground points (4, 2) under the corners of a unit's last image."""
    camera = history.mission.cameras_at(float(history.times_s[-1]))[unit]
    return footprint_m(camera, history.fleet(-1).pose(unit))


def _frame_ground(axes: Axes, history: History, footprints: list[Array]) -> None:
    """Set equal axes around all paths and fields of view, except corners that a tilt moves far away."""
    paths_m = np.concatenate([history.positions_m.reshape(-1, 2), history.unit_positions_m.reshape(-1, 2)])
    low, high = np.nanmin(paths_m, axis=0), np.nanmax(paths_m, axis=0)
    reach = FAR * float((high - low).max())
    corners_m = np.clip(np.concatenate(footprints), low - reach, high + reach)
    frame_square(axes, np.concatenate([paths_m, corners_m]))
