"""Figures of a live run."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from skyherd.drawing.palette import INK, MUTED, UNIT_COLORS, WARNING, unit_color
from skyherd.geometry import Array
from skyherd.live.review.image_paths import draw_images
from skyherd.live.review.latency import latency_stages, whole_way
from skyherd.live.review.process_history import ProcessHistory
from skyherd.live.review.reasons import DECIDING, armed_stretches, stretches, time_by_reason
from skyherd.live.review.session_history import SessionHistory
from skyherd.live.robot_core import DRIVING
from skyherd.plots.panels import Panel
from skyherd.plots.style import (
    draw_line,
    legend_above,
    new_figure,
    robot_colorbar,
    robot_colors,
    time_axes,
    use_log_scale,
)

ROW_IN, MAX_ROWS_IN = 0.3, 14.0
"""Height of a row of the timeline, and largest height of all rows, inches. Chosen: names stay legible."""

FIXED_COLORS = {DECIDING: UNIT_COLORS[0], DRIVING: UNIT_COLORS[2], "disarmed": "#d5d9de"}
"""Colours of the normal activities."""

REASON_COLORS = (*(UNIT_COLORS[k] for k in (1, 4, 3, 5, 6)), "#5a3a1a")
"""Colours of other reasons, by their total time; all further reasons share the last colour."""

MAX_POINTS = 1500
"""Largest number of points drawn per curve. Chosen: above the width of a figure in pixels."""


def draw_timeline(session: SessionHistory) -> Figure:
    """Draw the activity of every process over time, one row per process."""
    names = list(session.runs)
    row_in = min(ROW_IN, MAX_ROWS_IN / len(names))
    figure = new_figure(row_in * len(names) + 1.6)
    axes = figure.subplots()
    robots = list(session.logs("robot"))
    others = [reason for reason in time_by_reason(session, robots) if reason not in FIXED_COLORS]
    colors = FIXED_COLORS | {
        reason: REASON_COLORS[min(rank, len(REASON_COLORS) - 1)] for rank, reason in enumerate(others)
    }
    for row, logs in enumerate(session.runs.values()):
        for number, log in enumerate(logs):
            _draw_process(axes, session, log, row, colors)
            if number:
                (start_s,) = session.times_s(log, [log.times_s[0]])
                axes.plot(start_s, row, marker=9, color=WARNING, markersize=9, zorder=5)
    axes.set(xlabel="time (s)", ylim=(len(names) - 0.4, -0.6), xlim=(0, max(session.end_s, 1e-3)))
    axes.set_yticks(range(len(names)), names)
    axes.grid(axis="y", visible=False)
    shown = [*FIXED_COLORS, *others[: len(REASON_COLORS)]]
    handles: list[Patch | Line2D] = [
        Patch(color=colors[reason], label="other reasons" if reason == last else reason)
        for last in [shown[-1] if len(others) > len(REASON_COLORS) else None]
        for reason in shown
    ]
    handles.append(Line2D([], [], color=INK, linewidth=2, label="armed"))
    if session.restarts:
        handles.append(Line2D([], [], color=WARNING, marker=9, linestyle="", label="restarted"))
    if session.refused:
        handles.append(Line2D([], [], color=INK, marker="|", linestyle="", label="message refused"))
    legend_above(figure, handles, columns=3)
    return figure


def _draw_process(
    axes: Axes, session: SessionHistory, log: ProcessHistory, row: int, colors: dict[str, str]
) -> None:
    found = stretches(session, log)
    for reason in {stretch.reason for stretch in found}:
        spans = [(one.start_s, one.length_s) for one in found if one.reason == reason]
        axes.broken_barh(spans, (row - 0.35, 0.7), color=colors[reason], linewidth=0)
    if not log.is_unit:
        spans = [(one.start_s, one.length_s) for one in armed_stretches(session, log)]
        axes.broken_barh(spans, (row + 0.35, 0.1), color=INK, linewidth=0)
    refused_s = session.times_s(log, log.refused_at_s)
    axes.plot(refused_s, np.full(refused_s.size, row - 0.42), "|", color=INK, markersize=4)


def draw_shape_error(session: SessionHistory) -> Figure | None:
    """Draw the shape error of each unit's images. Return None if it is unknown."""
    logs = list(session.logs("unit"))
    if not any(np.isfinite(judged.shape_error) for log in logs for judged in log.judged):
        return None
    figure = new_figure(3.2)
    (axes,) = time_axes(figure, ["shape error, log"])
    for log in logs:
        times_s = session.times_s(log, [judged.time_s for judged in log.judged])
        errors = np.array([judged.shape_error for judged in log.judged])
        whole = np.array([judged.robots == len(session.lab.ids) for judged in log.judged], dtype=bool)
        color = unit_color(log.number)
        times, part = _few(times_s, np.where(whole, np.nan, errors))
        axes.plot(times, part, ".", color=color, markersize=2.5, alpha=0.5)
        draw_line(axes, *_few(times_s, np.where(whole, errors, np.nan)), color=color)
    use_log_scale(axes)
    handles = [Line2D([], [], color=unit_color(log.number), label=log.name) for log in session.first_units()]
    if any(judged.robots < len(session.lab.ids) for log in logs for judged in log.judged):
        handles.append(Line2D([], [], color=MUTED, marker=".", linestyle="", label="not all robots in view"))
    legend_above(figure, handles)
    return figure


def draw_latency(session: SessionHistory) -> Figure | None:
    """Draw median and 99th percentile of each stage, and the total latency over time."""
    stages = [stage for stage in latency_stages(session) if stage.times_s.size]
    if not stages:
        return None
    bars_in = 0.36 * len(stages) + 0.4
    figure = new_figure(bars_in + 2.9)
    bars, over_time = figure.subplots(2, 1, height_ratios=[bars_in, 2.0])
    for row, stage in enumerate(stages):
        color = INK if stage.key == "whole" else UNIT_COLORS[0]
        median_ms, p99_ms = 1e3 * stage.median_s, 1e3 * stage.p99_s
        bars.barh(row, p99_ms, height=0.3, color=color, alpha=0.3)
        bars.barh(row, median_ms, height=0.6, color=color)
        bars.annotate(
            f"{median_ms:.3g}, {p99_ms:.3g} ms",
            (max(median_ms, p99_ms, 0.0), row),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    bars.set_yticks(range(len(stages)), [stage.name for stage in stages])
    bars.set(xlabel="median (wide bars) and 99th percentile (thin bars), ms", ylim=(len(stages) - 0.5, -0.5))
    bars.margins(x=0.25)
    bars.set_xlim(left=min(0.0, *(1e3 * stage.median_s for stage in stages)))
    bars.grid(axis="y", visible=False)
    for name, times_s, ages_s in whole_way(session):
        order = np.argsort(times_s)
        times, ages = _few(times_s[order], 1e3 * ages_s[order])
        over_time.plot(
            times, ages, ".", color=unit_color(int(name.partition("/")[2])), markersize=2.5, label=name
        )
    over_time.set(xlabel="time (s)", ylabel="capture → command (ms)")
    over_time.margins(x=0)
    over_time.set_ylim(bottom=0.0)
    handles = [
        Line2D([], [], color=unit_color(log.number), marker=".", linestyle="", label=log.name)
        for log in session.first_units()
    ]
    legend_above(figure, handles)
    return figure


def draw_news_age(session: SessionHistory) -> Figure | None:
    """Draw the age of the newest image at each robot's decisions, and the watchdog timeout."""
    logs = [log for log in session.logs("robot") if any(np.isfinite(one.image_age_s) for one in log.decided)]
    if not logs:
        return None
    figure = new_figure(3.2)
    (axes,) = time_axes(figure, ["age of the newest image (s)"])
    limit_s = session.lab.model.limits.goal_timeout_s
    colors = dict(zip(session.lab.ids, robot_colors(len(session.lab.ids)), strict=True))
    max_s = limit_s
    for log in logs:
        times_s = session.times_s(log, [decided.time_s for decided in log.decided])
        ages_s = np.array([decided.image_age_s for decided in log.decided])
        max_s = max(max_s, float(np.nanpercentile(ages_s, 99)))
        draw_line(axes, *_few(times_s, ages_s), color=colors[log.number], linewidth=0.8)
    axes.axhline(limit_s, color=WARNING, linestyle="--", linewidth=1.2)
    axes.set_ylim(0, 1.25 * max_s)
    robot_colorbar(figure, [axes], np.array(session.lab.ids))
    legend_above(figure, [Line2D([], [], color=WARNING, linestyle="--", label="watchdog timeout")])
    return figure


def draw_clocks(session: SessionHistory) -> Figure | None:
    """Draw the offsets of the units' clocks as estimated by the other processes, with uncertainties."""
    figure = new_figure(3.2)
    (axes,) = time_axes(figure, ["clock offset (ms)"])
    drawn = set()
    for logs in session.runs.values():
        for log in logs:
            for name, samples in log.clocks.items():
                known = [sample for sample in samples if sample.known.is_known]
                if not known or name not in session.runs or not name.startswith("unit/"):
                    continue
                drawn.add(name)
                color = unit_color(int(name.partition("/")[2]))
                times_s = session.times_s(log, [sample.time_s for sample in known])
                offsets = 1e3 * np.array([sample.known.offset_s for sample in known])
                half = 1e3 * np.array([sample.known.uncertainty_s for sample in known])
                axes.fill_between(
                    times_s, offsets - half, offsets + half, color=color, alpha=0.08, linewidth=0
                )
                draw_line(axes, times_s, offsets, color=color, linewidth=0.8, alpha=0.7)
    if not drawn:
        return None
    handles = [
        Line2D([], [], color=unit_color(log.number), label=f"{log.name}, estimated by others")
        for log in session.first_units()
        if log.name in drawn
    ]
    legend_above(figure, handles, columns=3)
    return figure


def _few(times_s: Array, values: Array) -> tuple[Array, Array]:
    """Return a curve of at most `MAX_POINTS` points, each the maximum of an interval."""
    if times_s.size <= MAX_POINTS:
        return times_s, values
    starts = np.linspace(0, times_s.size, MAX_POINTS, endpoint=False).astype(int)
    return times_s[starts], np.fmax.reduceat(values, starts)


PANELS: tuple[Panel[SessionHistory], ...] = (
    Panel(
        "timeline",
        "Activity of the processes",
        "The colour shows that a robot drives, or why it stands still. The thin line below a robot shows "
        "when it was armed. A row is empty while its process does not run.",
        draw_timeline,
    ),
    Panel(
        "shape_error",
        "Shape error, as estimated by the units",
        "RMS distance of the robots in an image to the best-fitting similarity of the shape, divided by "
        "their RMS radius, on the ground as estimated by the unit. It is computed from detections only.",
        draw_shape_error,
    ),
    Panel(
        "latency",
        "Latency from capture to command",
        "Top: duration of each stage, the first one relative to the fastest picture. Bottom: age of the "
        "image at each resulting command.",
        draw_latency,
    ),
    Panel(
        "images",
        "Paths and goals in the images",
        "Path of every marker in pixels of the camera, and the last goals. Camera motion moves all paths.",
        draw_images,
    ),
    Panel(
        "news_age",
        "Age of the newest image at the robots",
        "Age of the newest image at each decision of a robot, on the robot's clock.",
        draw_news_age,
    ),
    Panel(
        "clocks",
        "Clocks",
        "Offset of the units' clocks from the clock of each other process, with its uncertainty, estimated "
        "from the time stamps of messages.",
        draw_clocks,
    ),
)
"""Figures of a live run's page, in their order."""
