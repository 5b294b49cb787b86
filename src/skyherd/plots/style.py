"""Common style of figures: axes, lines and legends."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from skyherd.drawing.palette import INK, MUTED, PAPER, unit_color
from skyherd.geometry import Array, IntArray

WIDTH_IN = 7.2
"""Default width of a figure, inches."""

DPI = 130
"""Resolution of PNG files, pixels per inch. Chosen: text is legible with two figures side by side; file size
grows with the square."""

FEW_DECADES = 2.0
"""Number of decades below which a logarithmic axis also has labels at 2 and 5 times the powers of ten. With
fewer decades, the powers alone might be one label or none."""

MIN_EXTENT = 1e-9
"""Minimum extent of axes around points, in the points' unit, so that a single point has axes."""

MAX_TICKS = 20
"""Approximate maximum number of named robots beside the colour bar; with more, every second, third, … is
named."""

_STYLE: Any = {
    "axes.axisbelow": True,
    "axes.edgecolor": MUTED,
    "axes.facecolor": PAPER,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 10,
    "figure.dpi": DPI,
    "figure.facecolor": PAPER,
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "grid.color": "#e4e7eb",
    "grid.linewidth": 0.7,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "lines.linewidth": 1.4,
    "path.simplify_threshold": 0.2,
    "savefig.facecolor": PAPER,
    "svg.hashsalt": "skyherd",
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
}


@contextmanager
def drawing_style() -> Iterator[None]:
    """Use skyherd's style for figures inside the context, over Matplotlib's defaults.

    The user's own settings have no effect inside, so that figures look the same everywhere. They are restored
    on exit.
    """
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def plain(text: str) -> str:
    """Escape a user's text for a figure: a dollar sign does not start a formula."""
    return text.replace("$", r"\$")


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """Create an empty figure with constrained layout of axes, labels and legends."""
    return Figure(figsize=(width_in, height_in), layout=ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08))


def time_axes(figure: Figure, labels: Sequence[str]) -> list[Axes]:
    """Create stacked axes with a common time axis in seconds, one for each vertical label."""
    rows: npt.NDArray[Any] = figure.subplots(len(labels), 1, sharex=True, squeeze=False)
    column: list[Axes] = list(rows[:, 0])
    for axes, label in zip(column, labels, strict=True):
        axes.set_ylabel(label)
        axes.margins(x=0)
    column[-1].set_xlabel("time (s)")
    figure.align_ylabels(column)
    return column


def frame_square(axes: Axes, points: Array) -> None:
    """Set equal scales and limits that show a square around points (K, 2), with a margin of 4 %."""
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    center, half = (low + high) / 2, 0.54 * max(float((high - low).max()), MIN_EXTENT)
    axes.set(
        xlim=(center[0] - half, center[0] + half), ylim=(center[1] - half, center[1] + half), aspect="equal"
    )


def draw_line(axes: Axes, times_s: Array, values: Array, **style: Any) -> Line2D:
    """Draw values (T,) over time, with gaps where they are NaN; a single finite value is drawn as a dot."""
    lone = np.isfinite(values).sum() == 1
    (line,) = axes.plot(times_s, values, marker="o" if lone else "", markersize=4, **style)
    return line


def draw_unit_lines(axes: Axes, times_s: Array, values: Array) -> None:
    """Draw a line for each unit's column of values (T, U), in its colour, labelled for the legend."""
    for unit, column in enumerate(values.T):
        draw_line(axes, times_s, column, color=unit_color(unit), label=f"unit {unit}")


def use_log_scale(axes: Axes) -> None:
    """Make the vertical axis logarithmic if its lines have a value above 0; else keep it linear."""
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.lines])
    shown = drawn[np.isfinite(drawn) & (drawn > 0)]
    if not shown.size:
        return
    axes.set_yscale("log", nonpositive="mask")
    axes.set_ylim(shown.min() / 1.5, shown.max() * 1.5)
    label_log_axis(axes.yaxis)


def label_log_axis(axis: Axis) -> None:
    """Put labelled ticks on a logarithmic axis, at least two for limits of half a decade, and ticks between.

    The limits of the axis must be set before.
    """
    low, high = axis.get_view_interval()
    few = np.log10(high / low) <= FEW_DECADES
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=16 if few else 7))
    axis.set_minor_locator(LogLocator(subs=tuple(range(2, 10)), numticks=100))
    axis.set_minor_formatter(NullFormatter())
    if few:
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))


def legend_above(figure: Figure, handles: Sequence[Artist] | None = None, columns: int = 6) -> None:
    """Put a legend above all axes; by default of the labelled lines of the first axes."""
    if handles is None:
        handles = figure.axes[0].get_legend_handles_labels()[0]
    if handles:
        figure.legend(handles=list(handles), loc="outside upper left", ncols=min(columns, len(handles)))


def unit_handles(units: int) -> list[Line2D]:
    """Return the legend entries for the units' colours."""
    return [Line2D([], [], color=unit_color(unit), lw=2, label=f"unit {unit}") for unit in range(units)]


def robot_colors(count: int) -> Array:
    """Return RGBA colours (N, 4) of robots in ascending order, dark to light, legible on white."""
    return np.asarray(mpl.colormaps["viridis"](np.linspace(0.0, 0.88, count)))


def robot_colorbar(figure: Figure, axes: Sequence[Axes], ids: IntArray) -> None:
    """Add a colour bar beside the axes that relates robots (N,) to `robot_colors`."""
    colors = ScalarMappable(Normalize(-0.5, ids.size - 0.5), ListedColormap(robot_colors(ids.size).tolist()))
    bar = figure.colorbar(colors, ax=list(axes), pad=0.02, aspect=40, label="robot", drawedges=False)
    every = max(1, round(ids.size / MAX_TICKS))
    bar.set_ticks(range(0, ids.size, every), labels=[str(robot) for robot in ids[::every]])
    bar.ax.tick_params(length=0)
    bar.ax.spines[:].set_visible(False)
