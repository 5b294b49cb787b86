"""Letters and digits as strokes: smooth curves between points where strokes end, turn or meet.

Points are complex, x right and y up. Letters stand on y = 0 and have height 1 and individual widths.
"""

import numpy as np

from skyherd.geometry import ComplexArray

DEGREES = 3.0
"""Angle between two vertices of the polyline of an arc, deg. Chosen: its error is 0.0004 of the radius."""

JOINED = 1e-9
"""Distance below which points of a curve count as one, letter heights. Chosen: far above the rounding of
sines."""


def _line(*points: complex) -> ComplexArray:
    return np.array(points, dtype=np.complex128)


def _arc(center: complex, radii: tuple[float, float], span_deg: tuple[float, float]) -> ComplexArray:
    """Return an elliptic arc with radii along x and y; counter-clockwise if the angles ascend."""
    start_deg, end_deg = span_deg
    angles = np.radians(np.linspace(start_deg, end_deg, round(abs(end_deg - start_deg) / DEGREES) + 1))
    return np.asarray(center + radii[0] * np.cos(angles) + 1j * radii[1] * np.sin(angles))


def _smooth(*parts: ComplexArray) -> ComplexArray:
    """Join consecutive parts into one curve."""
    joined = np.concatenate(parts)
    return np.asarray(joined[np.append(True, np.abs(np.diff(joined)) > JOINED)])


def _eight(start_deg: float, end_deg: float) -> ComplexArray:
    """Return part of `x = 0.31 + 0.31 sin 2t, y = 0.5 + 0.5 cos t`, which crosses itself in the middle."""
    t = np.radians(np.linspace(start_deg, end_deg, round((end_deg - start_deg) / DEGREES) + 1))
    return np.asarray(0.31 + 0.31 * np.sin(2 * t) + 0.5j + 0.5j * np.cos(t))


_BELLY = _smooth(_line(1j, 0.3 + 1j), _arc(0.3 + 0.735j, (0.3, 0.265), (90, -90)), _line(0.3 + 0.47j, 0.47j))
_RING = _arc(0.42 + 0.5j, (0.42, 0.5), (-45, 315))
_CUT = complex(_RING[0])
_HOOK = _arc(0.42 + 0.5j, (0.42, 0.5), (48, 352))
_SWAN = _arc(0.32 + 0.69j, (0.31, 0.31), (165, -40))
_FIVE = _arc(0.28 + 0.32j, (0.34, 0.32), (137, -155))
_UP, _LOW = 0.28, 2 - np.sqrt(2) - 0.28
_UPPER = _arc(0.3 + 1j * (1 - _UP), (_UP, _UP), (90, -45))
_WAIST = complex(_UPPER[-1])
_LOW_CENTER = _WAIST - _LOW * np.sqrt(0.5) * (1 + 1j)
_LOWER = _arc(_LOW_CENTER, (_LOW, _LOW), (45, -90))
_BACK = _arc(0.62 + 0.32j, (0.62, 0.68), (100, 160))
_JOINT = complex(_BACK[-1])
_SIX = (
    _BACK,
    _smooth(
        _arc(0.62 + 0.32j, (0.62, 0.68), (160, 180)),
        _arc(0.32 + 0.32j, (0.32, 0.32), (180, 360)),
        _arc(0.32 + 0.32j, (0.32, _JOINT.imag - 0.32), (0, 90)),
        _line(0.32 + 1j * _JOINT.imag, _JOINT),
    ),
)

STROKES: dict[str, tuple[ComplexArray, ...]] = {
    "A": (
        _line(0, 0.144 + 0.36j),
        _line(0.144 + 0.36j, 0.4 + 1j),
        _line(0.4 + 1j, 0.656 + 0.36j),
        _line(0.656 + 0.36j, 0.8),
        _line(0.144 + 0.36j, 0.656 + 0.36j),
    ),
    "B": (
        _line(0, 1j * _WAIST.imag),
        _line(1j * _WAIST.imag, 1j),
        _smooth(_line(1j, 0.3 + 1j), _UPPER),
        _line(1j * _WAIST.imag, _WAIST),
        _smooth(_LOWER, _line(_LOW_CENTER.real, 0)),
    ),
    "C": (_arc(0.42 + 0.5j, (0.42, 0.5), (48, 312)),),
    "D": (
        _line(0, 1j),
        _smooth(_line(1j, 0.28 + 1j), _arc(0.28 + 0.5j, (0.42, 0.5), (90, -90)), _line(0.28, 0)),
    ),
    "E": (
        _line(0, 0.5j),
        _line(0.5j, 1j),
        _line(0, 0.6),
        _line(0.5j, 0.5 + 0.5j),
        _line(1j, 0.6 + 1j),
    ),
    "F": (_line(0, 0.5j), _line(0.5j, 1j), _line(0.5j, 0.5 + 0.5j), _line(1j, 0.6 + 1j)),
    "G": (_HOOK, _line(_HOOK[-1], _HOOK[-1] - 0.38)),
    "H": (
        _line(0, 0.5j),
        _line(0.5j, 1j),
        _line(0.5j, 0.7 + 0.5j),
        _line(0.7, 0.7 + 0.5j),
        _line(0.7 + 0.5j, 0.7 + 1j),
    ),
    "I": (_line(0, 1j),),
    "J": (_smooth(_line(0.55 + 1j, 0.55 + 0.28j), _arc(0.275 + 0.28j, (0.275, 0.28), (0, -170))),),
    "K": (_line(0, 0.5j), _line(0.5j, 1j), _line(0.5j, 0.62 + 1j), _line(0.5j, 0.62)),
    "L": (_line(0, 1j), _line(0, 0.6)),
    "M": (
        _line(0, 1j),
        _line(1j, 0.5 + 0.45j),
        _line(0.5 + 0.45j, 1 + 1j),
        _line(1 + 1j, 1),
    ),
    "N": (_line(0, 1j), _line(1j, 0.8), _line(0.8, 0.8 + 1j)),
    "O": (_arc(0.42 + 0.5j, (0.42, 0.5), (90, 450)),),
    "P": (_line(0, 0.47j), _line(0.47j, 1j), _BELLY),
    "Q": (
        _RING,
        _line(_CUT + 0.22 * (1j - 1), _CUT),
        _line(_CUT, _CUT + 0.22 * (1 - 1j)),
    ),
    "R": (_line(0, 0.47j), _line(0.47j, 1j), _BELLY, _line(0.47j, 0.6)),
    "S": (
        _smooth(_arc(0.33 + 0.75j, (0.33, 0.25), (25, 270)), _arc(0.33 + 0.25j, (0.33, 0.25), (90, -155))),
    ),
    "T": (_line(1j, 0.38 + 1j), _line(0.38 + 1j, 0.76 + 1j), _line(0.38 + 1j, 0.38)),
    "U": (
        _smooth(_line(1j, 0.35j), _arc(0.35 + 0.35j, (0.35, 0.35), (180, 360)), _line(0.7 + 0.35j, 0.7 + 1j)),
    ),
    "V": (_line(1j, 0.42), _line(0.42, 0.84 + 1j)),
    "W": (
        _line(1j, 0.3),
        _line(0.3, 0.6 + 0.62j),
        _line(0.6 + 0.62j, 0.9),
        _line(0.9, 1.2 + 1j),
    ),
    "X": tuple(_line(0.39 + 0.5j, end) for end in (0, 1j, 0.78 + 1j, 0.78)),
    "Y": tuple(_line(0.4 + 0.47j, end) for end in (1j, 0.8 + 1j, 0.4)),
    "Z": (_line(1j, 0.72 + 1j), _line(0.72 + 1j, 0), _line(0, 0.72)),
    "0": (_arc(0.31 + 0.5j, (0.31, 0.5), (90, 450)),),
    "1": (_line(0.72j, 0.32 + 1j), _line(0.32 + 1j, 0.32)),
    "2": (_smooth(_SWAN, _line(_SWAN[-1], 0)), _line(0, 0.66)),
    "3": (
        _smooth(_arc(0.3 + 1j * (1 - _UP), (_UP, _UP), (165, 90)), _UPPER),
        _smooth(_LOWER, _arc(_LOW_CENTER, (_LOW, _LOW), (-90, -165))),
    ),
    "4": (
        _line(0.55, 0.55 + 0.32j),
        _line(0.55 + 0.32j, 0.55 + 1j),
        _line(0.55 + 1j, 0.32j),
        _line(0.32j, 0.55 + 0.32j),
    ),
    "5": (
        _line(0.58 + 1j, 0.08 + 1j),
        _line(0.08 + 1j, _FIVE[0]),
        _FIVE,
    ),
    "6": _SIX,
    "7": (_line(1j, 0.66 + 1j), _line(0.66 + 1j, 0.22)),
    "8": (_eight(-90, 90), _eight(90, 270)),
    "9": tuple(0.64 + 1j - stroke for stroke in _SIX),
}
"""Strokes of each letter and digit, polylines (M,). Strokes meet where their ends coincide. Chosen by eye;
the names above are parts used by several strokes."""
