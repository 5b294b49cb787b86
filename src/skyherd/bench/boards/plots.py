"""Figures of the result on boards: error distributions, medians over the floor, board errors."""

import numpy as np
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from skyherd.bench.boards.measurement import Measurement
from skyherd.bench.detector_style import style_of
from skyherd.bench.set_result import SetResult
from skyherd.drawing.palette import INK, MUTED, UNIT_COLORS
from skyherd.plots.panels import Panel
from skyherd.plots.style import legend_above, new_figure, plain

LOWEST_PX = 0.005
"""Lower end of error axes, px. Chosen: below the median of any detector on photographs."""

ARROW_SIDES = 0.35
"""Length of the median arrow in the figure of a board's errors, in marker sides. Chosen: arrows are visible,
and barely reach the next marker."""


def make_panels(result: SetResult) -> tuple[Panel[Measurement], ...]:
    """Return the figures of a result, in the order shown."""
    return (
        Panel(
            "distributions",
            "Errors of the centre",
            "Share of the markers found whose centre is off by less than a distance; the dotted line is "
            "the floor's median.",
            lambda measured: draw_distributions(result, measured),
        ),
        Panel(
            "medians",
            "Median errors",
            "Of centre, corners and heading, in each set; the short line is the floor that all detectors "
            "share.",
            lambda _: draw_medians(result),
        ),
        Panel(
            "boards",
            "Errors of the boards",
            "Displacement of each corner from its nominal position, estimated from all detectors and "
            "images; arrows are enlarged.",
            draw_boards,
        ),
    )


def draw_distributions(result: SetResult, measured: Measurement) -> Figure | None:
    """Draw, for each set, the cumulative distribution of centre errors."""
    sets = [name for name, found in measured.sets.items() if found.errors]
    if not sets:
        return None
    columns = min(len(sets), 3)
    rows = -(-len(sets) // columns)
    figure = new_figure(3.1 * rows + 0.8, 3.6 * columns + 0.6)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    for axes in panels[len(sets) :]:
        axes.set_visible(False)
    names = result.detectors
    for name, axes in zip(sets, panels, strict=False):
        found = measured.sets[name]
        for detector, errors in found.errors.items():
            lengths = np.sort(np.linalg.norm(errors.center, axis=1)) * errors.share_of_detector("center")
            shares = np.arange(1, lengths.size + 1) / lengths.size
            axes.plot(lengths, shares, **(style_of(names, detector) | {"marker": ""}))
        row = next(row for row in result.rows if row["set"] == name)
        if row["center_floor_px"]:
            axes.axvline(row["center_floor_px"], color=MUTED, lw=1.0, ls=":")
        axes.set(title=plain(name), xscale="log", ylim=(0, 1), xlim=(LOWEST_PX, 3.0))
        axes.set_xlabel("error of the centre (px)")
        _plain_logarithms(axes.xaxis)
    for axes in panels[::columns]:
        axes.set_ylabel("share of markers")
    handles = [
        Line2D([], [], label=plain(name), **(style_of(names, name) | {"marker": ""})) for name in names
    ]
    legend_above(figure, handles, columns=5)
    return figure


def draw_medians(result: SetResult) -> Figure | None:
    """Draw the median errors of centre, corners and heading as points, sets side by side."""
    sets = [name for name in result.sets if name not in result.unread()]
    if not sets:
        return None
    figure = new_figure(4.2, 11.0)
    panels = figure.subplots(1, 3)
    names = result.detectors
    for axes, (key, label) in zip(
        panels,
        (("center_px", "centre (px)"), ("corner_px", "corners (px)"), ("heading_deg", "heading (deg)")),
        strict=True,
    ):
        quantity, unit = key.split("_")
        for index, detector in enumerate(names):
            rows = [result.row(name, detector) for name in sets]
            values = [np.nan if row is None or row[key] is None else row[key] for row in rows]
            places = np.arange(len(sets)) + 0.08 * (index - (len(names) - 1) / 2)
            axes.plot(places, values, **(style_of(names, detector) | {"linestyle": ""}))
        for place, name in enumerate(sets):
            row = next(row for row in result.rows if row["set"] == name)
            floor = row[f"{quantity}_floor_{unit}"]
            if floor:
                axes.hlines(floor, place - 0.4, place + 0.4, color=INK, lw=1.0)
        axes.set(ylabel=f"median error, {label}", yscale="log", xlim=(-0.6, len(sets) - 0.4))
        axes.set_xticks(range(len(sets)), [plain(name) for name in sets], rotation=30, ha="right")
        _plain_logarithms(axes.yaxis)
    handles = [
        Line2D([], [], label=plain(name), **(style_of(names, name) | {"linestyle": ""})) for name in names
    ]
    legend_above(figure, handles, columns=5)
    return figure


def _plain_logarithms(axis: Axis) -> None:
    """Label a logarithmic axis at 1, 2 and 5 of each decade, as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def draw_boards(measured: Measurement) -> Figure | None:
    """Draw the displacements of each board's corners as enlarged arrows."""
    boards = {name: found for name, found in measured.boards.items() if found[1].displacements.any()}
    if not boards:
        return None
    figure = new_figure(4.6, 4.4 * len(boards) + 0.4)
    panels = figure.subplots(1, len(boards), squeeze=False)[0]
    for axes, (name, (corners, errors)) in zip(panels, boards.items(), strict=True):
        points, moves = corners.reshape(-1, 2), errors.displacements.reshape(-1, 2)
        lengths = np.linalg.norm(moves, axis=1)
        known = lengths > 0
        typical = float(np.median(lengths[known])) if known.any() else 1.0
        for square in corners:
            axes.fill(*square.T, facecolor="none", edgecolor=MUTED, lw=0.6)
        axes.quiver(
            *points[known].T,
            *moves[known].T,
            angles="xy",
            scale_units="xy",
            scale=typical / ARROW_SIDES,
            color=UNIT_COLORS[1],
            width=0.004,
        )
        axes.set(aspect="equal", title=f"{plain(name)}: median {100 * typical:.2f} % of a side")
        axes.invert_yaxis()
        axes.set_axis_off()
    return figure
