"""Words as formation shapes: robots spread along the strokes of letters.

Strokes (`skyherd.datasets.shapes.letters`) only meet at their ends. A robot stands at each end; Webster's
rule shares the rest out among the strokes, by which spacings differ least from their mean.
"""

from dataclasses import dataclass
from heapq import heapify, heapreplace

import numpy as np
from scipy.spatial import cKDTree

from skyherd.datasets.shapes.letters import STROKES
from skyherd.errors import InputError
from skyherd.geometry import Array, ComplexArray, to_points

PREFIX = "word:"
"""What the name of a shape that is a word begins with."""

GAP = 0.42
"""Room between two letters, in heights. *Chosen*: wider than the gaps between robots, so that letters stay
apart."""

TURN_DEG = 62.0
"""A curve has a robot at least every so many degrees of its turn. *Chosen*: rings get six robots or more, and
look round."""

REACH = 0.75
"""A stroke has a robot at least every so many heights. *Chosen*: a letter's full height has one between its
ends, so that it looks like a line."""

MIN_SPACING = 0.6
"""Least distance of two robots, in mean distances between neighbours on a stroke. *Chosen*: nearer ones would
read as a joint, or collide."""

MAX_LETTERS = 40
"""Letters of the longest word. *Chosen*: longer texts are mistakes, and would take long to try."""

MAX_MORE = 1000
"""By how many more robots a word is tried for the error that says how many it takes. *Chosen*: forty letters
take fewer, and all are tried in a second."""

MET = 1e-6
"""Ends of strokes nearer than this are one point, in heights. *Chosen*: far above the rounding of arcs, far
below a letter."""


@dataclass(frozen=True)
class Stroke:
    """A curve without corners.

    Attributes:
        curve: (M,) points of the polyline, `x + iy`, in letter heights.
        ends: numbers of the joints at which it begins and ends.
    """

    curve: ComplexArray
    ends: tuple[int, int]

    @property
    def length(self) -> float:
        """Length of the curve, in letter heights."""
        return float(np.abs(np.diff(self.curve)).sum())

    @property
    def min_parts(self) -> int:
        """Least number of parts into which robots cut it, by `TURN_DEG` and `REACH`."""
        turns = np.angle(np.diff(self.curve)[1:] / np.diff(self.curve)[:-1])
        return int(np.ceil(max(np.degrees(np.abs(turns).sum()) / TURN_DEG, self.length / REACH)))

    def cut(self, parts: int) -> ComplexArray:
        """The points (parts - 1,), `x + iy`, that cut it into parts of equal length."""
        along = np.append(0.0, np.cumsum(np.abs(np.diff(self.curve))))
        at = along[-1] * np.arange(1, parts) / parts
        return np.asarray(np.interp(at, along, self.curve.real) + 1j * np.interp(at, along, self.curve.imag))


def word_points(text: str, count: int) -> Array:
    """Points (N, 2), x right and y up, of `count` robots that write a word, in writing order.

    Letters are 1 high.

    Robots stand wherever a stroke ends, turns sharply or meets another, and share out the rest of the
    strokes as evenly as whole numbers allow: the next robot goes to the stroke whose length over
    `parts + 1/2` is greatest (Webster's rule, by which parts differ least from their mean).

    Raises:
        InputError: the text is empty, too long or has other signs than A-Z and 0-9, or the robots are too
            few.
    """
    if not text or len(text) > MAX_LETTERS or not set(text) <= set(STROKES):
        what = f"no shape {PREFIX + text!r}"
        raise InputError("template.shape", what, f"1 to {MAX_LETTERS} letters A-Z and digits, as {PREFIX}SKY")
    strokes, joints = _strokes(text)
    points = _spread(strokes, joints, count)
    if points is None:
        more = range(count + 1, count + MAX_MORE)
        enough = next((n for n in more if _spread(strokes, joints, n) is not None), None)
        allowed = "fewer letters" if enough is None else f"at least {enough} robots"
        raise InputError("template.shape", f"{count} robots to write {text}", allowed)
    return to_points(points)


def _strokes(text: str) -> tuple[list[Stroke], ComplexArray]:
    """Strokes of a word, and the points where they begin and end."""
    curves, joints, left = [], np.zeros(0, dtype=np.complex128), 0.0
    for letter in text:
        curves += [curve + left for curve in STROKES[letter]]
        left += max(float(curve.real.max()) for curve in STROKES[letter]) + GAP
    strokes = []
    for curve in curves:
        ends = []
        for end in (curve[0], curve[-1]):
            met = np.flatnonzero(np.abs(joints - end) < MET)
            ends.append(int(met[0]) if met.size else joints.size)
            joints = joints if met.size else np.append(joints, end)
        strokes.append(Stroke(curve, (ends[0], ends[1])))
    return strokes, joints


def _spread(strokes: list[Stroke], joints: ComplexArray, count: int) -> ComplexArray | None:
    """Points (N,) of so many robots in writing order, or None if they are too few or stand too close."""
    parts = [stroke.min_parts for stroke in strokes]
    spare = count - joints.size - sum(parts) + len(parts)
    if spare < 0:
        return None
    lengths = [stroke.length for stroke in strokes]
    queue = [(-length / (part + 0.5), k) for k, (length, part) in enumerate(zip(lengths, parts, strict=True))]
    heapify(queue)
    for _ in range(spare):
        k = queue[0][1]
        parts[k] += 1
        heapreplace(queue, (-lengths[k] / (parts[k] + 0.5), k))
    points, written = [], set[int]()
    for stroke, part in zip(strokes, parts, strict=True):
        first, last = stroke.ends
        points += [joints[[first]]] if first not in written else []
        points.append(stroke.cut(part))
        points += [joints[[last]]] if last not in written | {first} else []
        written |= {first, last}
    placed = np.concatenate(points)
    nearest = np.asarray(cKDTree(to_points(placed)).query(to_points(placed), k=2)[0])[:, 1]
    is_clear = nearest.min() >= MIN_SPACING * sum(lengths) / sum(parts)
    return placed if is_clear else None
