"""Words as formation shapes: robots distributed along the strokes of letters.

Strokes (`skyherd.datasets.shapes.letters`) meet only at their ends. One robot stands at each end. Webster's
rule (`skyherd.datasets.shapes.strokes`) distributes the others among the strokes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from skyherd.datasets.shapes.letters import STROKES
from skyherd.datasets.shapes.strokes import MIN_SPACING, divide
from skyherd.errors import InputError
from skyherd.geometry import Array, ComplexArray, to_points

PREFIX = "word:"
"""Prefix of the name of a shape that is a word."""

GAP = 0.42
"""Gap between two letters, letter heights. Chosen: wider than the gaps between robots, so that letters are
distinct."""

TURN_DEG = 62.0
"""Maximum turn of a curve between two robots, deg. Chosen: rings get six robots or more and look round."""

REACH = 0.75
"""Maximum length of stroke between two robots, letter heights. Chosen: a stroke of full height has a robot
between its ends, so that it looks like a line."""

MAX_LETTERS = 40
"""Maximum number of letters of a word. Chosen: longer texts are mistakes, and slow to try."""

MAX_MORE = 1000
"""Maximum number of additional robots tried for the error that states the required number. Chosen: forty
letters take fewer, and all are tried in one second."""

MET = 1e-6
"""Distance below which ends of strokes count as one point, letter heights. Chosen: far above the rounding
of arcs, far below a letter."""


@dataclass(frozen=True)
class Stroke:
    """A curve without corners.

    Attributes:
        curve: (M,) points of the polyline, `x + iy`, in letter heights.
        ends: indices of the joints at which it begins and ends.
    """

    curve: ComplexArray
    ends: tuple[int, int]

    @property
    def length(self) -> float:
        """Length of the curve, in letter heights."""
        return float(np.abs(np.diff(self.curve)).sum())

    @property
    def min_parts(self) -> int:
        """Minimum number of parts into which robots divide it, by `TURN_DEG` and `REACH`."""
        turns = np.angle(np.diff(self.curve)[1:] / np.diff(self.curve)[:-1])
        return int(np.ceil(max(np.degrees(np.abs(turns).sum()) / TURN_DEG, self.length / REACH)))

    def cut(self, parts: int) -> ComplexArray:
        """Return the points (parts - 1,), `x + iy`, that divide it into parts of equal length."""
        along = np.append(0.0, np.cumsum(np.abs(np.diff(self.curve))))
        at = along[-1] * np.arange(1, parts) / parts
        return np.asarray(np.interp(at, along, self.curve.real) + 1j * np.interp(at, along, self.curve.imag))


def word_points(text: str, count: int) -> Array:
    """Return the points (N, 2), x right and y up, of robots that write a word, in writing order.

    Letters have height 1. One robot stands wherever a stroke ends, turns sharply or meets another. The others
    are distributed by Webster's rule.

    Raises:
        InputError: the text is empty, too long or has characters other than A-Z and 0-9, or there are too few
            robots.
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


def word_outline(text: str) -> list[Array]:
    """Return the strokes of a word's letters as polylines (M, 2), in the frame of `word_points`."""
    return [to_points(stroke.curve) for stroke in _strokes(text)[0]]


def _strokes(text: str) -> tuple[list[Stroke], ComplexArray]:
    """Return the strokes of a word, and the points where they begin and end."""
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
    """Return points (N,) of the robots in writing order, or None if they are too few or too close."""
    parts = [stroke.min_parts for stroke in strokes]
    spare = count - joints.size - sum(parts) + len(parts)
    if spare < 0:
        return None
    lengths = [stroke.length for stroke in strokes]
    parts = divide(lengths, parts, spare)
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
