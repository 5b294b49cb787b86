"""Axes of the benchmark's figures: marker sides, ratios to the bound, shares."""

from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from skyherd.drawing.palette import INK, MUTED

AIM = 1.2
"""Target ratio of RMSE to bound; a dotted line in the figures."""

SIDE_TICKS = (8, 12, 16, 20, 30, 40, 60, 100)
"""Marker sides, px, that have a tick."""

RATIO_TICKS = (1, 2, 5, 10, 20, 50, 100, 200, 500)
"""Ratios that have a tick."""

MARGIN = 1.15
"""Factor by which logarithmic axes extend beyond the least and the greatest value."""


def side_axis(axes: Axes, sides_px: Iterable[float]) -> None:
    """Format the horizontal axis for marker sides, px: logarithmic, with ticks as plain numbers."""
    sides = sorted(set(sides_px))
    axes.set_xscale("log")
    ticks = [side for side in SIDE_TICKS if sides[0] <= side <= sides[-1]]
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda side, _: f"{side:g}"))


def span(panels: Sequence[Axes], low: float, high: float) -> tuple[float, float]:
    """Return the limits of log axes that show all lines of some panels, and `low` and `high`."""
    lines = [line for axes in panels for line in axes.lines]
    drawn = np.concatenate([[low, high], *(np.asarray(line.get_ydata(), float) for line in lines)])
    shown = drawn[np.isfinite(drawn) & (drawn > 0)]
    return float(shown.min() / MARGIN), float(shown.max() * MARGIN)


def ratio_axes(panels: Sequence[Axes]) -> None:
    """Format vertical axes for ratios to the bound: logarithmic, equal, with lines at 1 and at `AIM`."""
    low, high = span(panels, 0.9, 3.0)
    for axes in panels:
        _ratio_axis(axes, low, high)


def _ratio_axis(axes: Axes, low: float, high: float) -> None:
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    axes.yaxis.set_major_locator(FixedLocator([tick for tick in RATIO_TICKS if low <= tick <= high]))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda ratio, _: f"{ratio:g}"))
    axes.axhline(1.0, color=INK, lw=1.0, zorder=1)
    axes.axhline(AIM, color=MUTED, lw=0.9, ls=":", zorder=1)


def share_axes(panels: Sequence[Axes]) -> None:
    """Format vertical axes for shares from 0 to 1."""
    for axes in panels:
        axes.set_ylim(-0.03, 1.03)
