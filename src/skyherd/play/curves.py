"""Curves of shape error and cost over time, with a logarithmic axis."""

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from skyherd.drawing.palette import INK, TEMPLATE_COLOR
from skyherd.loop import Step

if TYPE_CHECKING:
    import viser

CURVE_POINTS = 400
"""Points of the curves. Chosen: one for each pixel of the panel."""

CURVE_PX = 190
"""Height of the curves, px. Chosen: they are seen without scrolling on a phone."""

MIN_SHOWN = 1e-5
"""Smallest value in the curves with their logarithmic axis. Chosen: far below any goal."""


class Curves:
    """Plot of shape error and cost V.

    Args:
        gui: viser's interface.
    """

    def __init__(self, gui: "viser.GuiApi") -> None:
        self._times_s: deque[float] = deque()
        self._values: deque[tuple[float, float]] = deque()
        empty = np.array([0.0, 1.0])
        self._plot = gui.add_uplot(
            (empty, empty, empty),
            (
                {"label": "time, s"},
                {"label": "shape error", "stroke": TEMPLATE_COLOR, "width": 2},
                {"label": "cost V, m²", "stroke": INK, "width": 2, "dash": (6, 4)},
            ),
            scales={"x": {"time": False}, "y": {"distr": 3, "log": 10}},
            height=CURVE_PX,
            padding=(8, 24, 0, 0),
        )

    def __len__(self) -> int:
        return len(self._times_s)

    def clear(self) -> None:
        """Forget all values."""
        self._times_s.clear()
        self._values.clear()

    def collect(self, step: Step) -> None:
        """Add a step; every second value is dropped when there are too many."""
        self._times_s.append(step.time_s)
        self._values.append((step.metrics.shape.error, step.metrics.V))
        if len(self._times_s) > 2 * CURVE_POINTS:
            self._times_s = deque(list(self._times_s)[::2])
            self._values = deque(list(self._values)[::2])

    def show(self) -> None:
        """Show the values so far."""
        values = np.maximum(np.array(self._values), MIN_SHOWN)
        self._plot.data = (np.array(self._times_s), values[:, 0], values[:, 1])
