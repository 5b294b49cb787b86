"""Axes of the benchmark's figures: sides, ratios to the bound, shares."""

from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from skyherd.drawing.palette import INK, MUTED

AIM = 1.2
SIDE_TICKS = (8, 12, 16, 20, 30, 40, 60, 100)


def side_axis(axes: Axes, sides_px: Iterable[float]) -> None:
    """A log axis of marker sides, with plain numbers."""
    sides = sorted(set(sides_px))
    axes.set_xscale("log")
    ticks = [side for side in SIDE_TICKS if sides[0] <= side <= sides[-1]]
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda side, _: f"{side:g}"))


def span(panels: Sequence[Axes], low: float, high: float) -> tuple[float, float]:
    """Limits of log axes that show all lines, and `low` and `high` at least."""
    lines = [line for axes in panels for line in axes.lines]
    drawn = np.concatenate([[low, high], *(np.asarray(line.get_ydata(), float) for line in lines)])
    shown = drawn[np.isfinite(drawn) & (drawn > 0)]
    return float(shown.min() / 1.15), float(shown.max() * 1.15)


def ratio_axes(panels: Sequence[Axes]) -> None:
    """Log axes of ratios, all alike, with the bound and the aim."""
    low, high = span(panels, 0.9, 3.0)
    for axes in panels:
        _ratio_axis(axes, low, high)


def _ratio_axis(axes: Axes, low: float, high: float) -> None:
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    axes.yaxis.set_major_locator(
        FixedLocator([t for t in (1, 2, 5, 10, 20, 50, 100, 200, 500) if low <= t <= high])
    )
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda ratio, _: f"{ratio:g}"))
    axes.axhline(1.0, color=INK, lw=1.0, zorder=1)
    axes.axhline(AIM, color=MUTED, lw=0.9, ls=":", zorder=1)


def share_axes(panels: Sequence[Axes]) -> None:
    """Axes from nothing to all."""
    for axes in panels:
        axes.set_ylim(-0.03, 1.03)
