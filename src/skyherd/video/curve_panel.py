"""Growing curves over time: only new samples are drawn, unless the axis changes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.drawing.canvas import Box, Color, draw_lines, draw_text
from skyherd.drawing.palette import INK, MUTED, PAPER, rgb
from skyherd.geometry import Array, RgbImage
from skyherd.video.axis_ticks import LinearRange, LogRange, tick_values

TITLE_PX = 28
LEFT_PX = 52
RIGHT_PX = 14
BOTTOM_PX = 40
"""Margins of the plot area, px: title above, labels to the left and below."""

GRID: Color = (232, 233, 231)
"""Colour of the grid."""


@dataclass(frozen=True)
class Curve:
    """Colour and width of one curve."""

    color: Color
    width_px: int = 2


class CurvePanel:
    """Curves over time in a panel of the canvas, kept from frame to frame.

    Args:
        panel: the part of the canvas to draw in.
        title: the plotted quantity, with its unit.
        curves: one for each value of a sample; later ones are drawn over earlier ones.
        duration_s: end of the time axis.
        log: use a logarithmic axis instead of a linear one.
    """

    def __init__(
        self, panel: RgbImage, title: str, curves: Sequence[Curve], duration_s: float, *, log: bool = False
    ) -> None:
        self._panel, self._title, self._curves, self._duration_s = panel, title, curves, duration_s
        self._kind: type[LinearRange] | type[LogRange] = LogRange if log else LinearRange
        self._range: LinearRange | LogRange | None = None
        self._times_s: list[float] = []
        self._values: list[Array] = []
        box = Box(
            left=LEFT_PX,
            top=TITLE_PX,
            width=panel.shape[1] - LEFT_PX - RIGHT_PX,
            height=panel.shape[0] - TITLE_PX - BOTTOM_PX,
        )
        self._field = box.of(panel)

    def add(self, time_s: float, values: Array) -> None:
        """Extend the curves by values (C,), NaN where unknown; redraw all if they do not fit."""
        self._times_s.append(time_s)
        self._values.append(values)
        axis = self._kind.around(values) if self._range is None else self._range.widened(values)
        if axis != self._range:
            self._range = axis
            self._draw_axes(axis)
            self._draw_curves(axis, 0)
        else:
            self._draw_curves(axis, -2)

    def _to_field(self, axis: LinearRange | LogRange, times_s: Array, values: Array) -> Array:
        height, width = self._field.shape[:2]
        u = times_s / self._duration_s * (width - 1)
        v = (1 - axis.place(values)) * (height - 1)
        return np.stack([u, v], axis=-1)

    def _draw_curves(self, axis: LinearRange | LogRange, first: int) -> None:
        """Draw the curves from sample `first` on."""
        times, values = np.array(self._times_s[first:]), np.array(self._values[first:])
        for curve, column in zip(self._curves, values.T, strict=True):
            whole = np.isfinite(column)
            points = self._to_field(axis, times, np.where(whole, column, 1.0))
            pairs = np.flatnonzero(whole[1:] & whole[:-1])
            draw_lines(self._field, [points[k : k + 2] for k in pairs], curve.color, curve.width_px)

    def _draw_axes(self, axis: LinearRange | LogRange) -> None:
        """Clear the panel and draw title, grid and labels."""
        height, width = self._field.shape[:2]
        self._panel[:] = rgb(PAPER)
        draw_text(self._panel, self._title, (LEFT_PX, TITLE_PX / 2), rgb(INK), size_px=15)
        for value, label in axis.ticks().items():
            v = float(self._to_field(axis, np.zeros(1), np.array([value]))[0, 1])
            draw_lines(self._field, [[[0, v], [width, v]]], GRID)
            at = LEFT_PX - 7, TITLE_PX + v
            draw_text(self._panel, label, at, rgb(MUTED), size_px=12, align="right")
        for time in tick_values(0.0, self._duration_s, 10):
            u = time / self._duration_s * (width - 1)
            draw_lines(self._field, [[[u, 0], [u, height]]], GRID)
            at = LEFT_PX + u, TITLE_PX + height + 11
            draw_text(self._panel, f"{time:g}", at, rgb(MUTED), size_px=12, align="center")
        draw_lines(self._field, [[[0, 0], [0, height - 1], [width - 1, height - 1]]], rgb(MUTED))
        at = LEFT_PX + width / 2, TITLE_PX + height + 30
        draw_text(self._panel, "time, s", at, rgb(INK), size_px=13, align="center")
