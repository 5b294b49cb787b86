"""Axis ranges of the video's curves, linear or logarithmic, and round tick values."""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


ROUNDING = 1e-9
"""Tolerance within which a value counts as a multiple of the step, as a share of the step."""

MIN_ROOM = 1e-9
"""Minimum margin around values of a linear range, so that a constant has a range."""

DECADES = 4
"""Initial decades of a logarithmic range. Chosen: V of a run decreases by about as much."""


def tick_values(low: float, high: float, count: int) -> Array:
    """Return about `count` multiples of 1, 2 or 5 times a power of ten in [low, high]."""
    rough = (high - low) / count
    steps = np.array([1.0, 2.0, 5.0, 10.0]) * 10.0 ** np.floor(np.log10(rough))
    step = steps[np.abs(np.log(steps / rough)).argmin()]
    return np.asarray(
        np.arange(np.ceil(low / step - ROUNDING), np.floor(high / step + ROUNDING) + 1) * step + 0.0
    )


@dataclass(frozen=True)
class LinearRange:
    """A linear axis from `low` to `high`."""

    low: float
    high: float

    @classmethod
    def around(cls, values: Array) -> "LinearRange":
        """Return a range with a margin around the finite `values`; 0 to 1 if there are none."""
        finite = values[np.isfinite(values)]
        if not finite.size:
            return cls(0.0, 1.0)
        low, high = float(finite.min()), float(finite.max())
        room = max(0.25 * (high - low), 0.1 * abs(high), MIN_ROOM)
        return cls(low - room, high + room)

    def place(self, values: Array) -> Array:
        """Return the positions of values (...) along the axis: 0 at its low end, 1 at its high end."""
        return np.asarray((values - self.low) / (self.high - self.low))

    def widened(self, values: Array) -> "LinearRange":
        """Return a range that holds `values` as well; itself if it already does."""
        finite = values[np.isfinite(values)]
        if not finite.size or (finite.min() >= self.low and finite.max() <= self.high):
            return self
        return LinearRange.around(np.append(finite, [self.low, self.high]))

    def ticks(self) -> dict[float, str]:
        """Return the values that have a tick, and their labels."""
        return {float(value): f"{value:g}" for value in tick_values(self.low, self.high, 5).round(12)}


@dataclass(frozen=True)
class LogRange:
    """A logarithmic axis from `10**low` to `10**high`, of `most` decades at most; less is at its bottom."""

    low: int
    high: int
    most: int = 12

    @classmethod
    def around(cls, values: Array) -> "LogRange":
        """Return a range of `DECADES` decades up to the largest of `values`."""
        top = float(np.nanmax(values, initial=0.0))
        high = int(np.ceil(np.log10(top))) if top > 0 else 0
        return cls(high - DECADES, high)

    def place(self, values: Array) -> Array:
        """Return the positions of values along the axis: 0 at its low end, 1 at its high end."""
        exponents = np.log10(np.maximum(values, 10.0**self.low))
        return np.asarray((exponents - self.low) / (self.high - self.low))

    def widened(self, values: Array) -> "LogRange":
        """Return a range that also holds `values`, up to `most` decades; itself if it already does."""
        positive = values[np.isfinite(values) & (values > 0)]
        if not positive.size:
            return self
        high = max(self.high, int(np.ceil(np.log10(positive.max()))))
        low = max(min(self.low, int(np.floor(np.log10(positive.min())))), high - self.most)
        return self if (low, high) == (self.low, self.high) else LogRange(low, high, self.most)

    def ticks(self) -> dict[float, str]:
        """Return the values that have a tick, and their labels."""
        step = 1 if self.high - self.low <= 6 else 2
        exponents = range(self.high, self.low - 1, -step)
        return {10.0**power: "10" + str(power).translate(_SUPERSCRIPTS) for power in exponents}
