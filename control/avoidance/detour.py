"""Detours: the velocity of a robot whose preferred velocity is blocked by bodies nearby.

A detour only has to be useful. Safety is the bound on the approach speed, which is applied afterwards
(`skyherd.control.avoidance.speed_bound`), so that a detour rule may choose anything.
"""

from collections.abc import Mapping
from typing import Literal, Protocol

import numpy as np

from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, wrap_angle

DIRECTIONS = 36
"""Directions that `around` compares, evenly spread: one in 10 degrees. Chosen: the cost is in proportion."""

SIDEWAYS = 0.2
"""Score of moving in itself, beside the cosine that scores progress. Chosen: above 0, a robot that faces an
obstacle still gains by sliding past it at 90 degrees; the larger, the longer the detours it accepts."""

RIGHT_HAND = 0.05
"""Penalty, as a share of the score, of directions to the left. Chosen: it breaks the tie between passing left
and passing right, so that two robots that meet head-on both keep to the right."""

HEAD_ON_RAD = 0.05
"""Angle up to which `gyroscopic` takes an encounter as head-on and passes to the right, rad (3 degrees)."""

MIN_COSINE = 1e-9
"""A direction whose cosine to a body is below this does not approach it. Chosen: above the rounding of a
cosine (1e-16); an approach at 1e-9 of a robot's speed is harmless, and bounded afterwards in any case."""


class DetourRule(Protocol):
    """A rule that finds other velocities for robots whose preferred velocities are blocked."""

    def __call__(
        self, preferred: ComplexArray, *, rows: IntArray, bearings_rad: Array, speeds_mps: Array
    ) -> tuple[IntArray, ComplexArray]:
        """Rows (R,) of the robots that are blocked, ascending, and the velocities (R,) to take instead.

        A robot is blocked if its preferred velocity approaches some body faster than the bound allows.
        Robots that are not blocked must not be among the rows: they keep the paper's law to the bit.

        Args:
            preferred: (N,) preferred velocities in the robots' frames, `forward + i left`, m/s.
            rows: (P,) row of the robot that each bound is for.
            bearings_rad: (P,) direction to the other body in the robot's frame, positive to the left.
            speeds_mps: (P,) greatest speed of approach.
        """
        ...


def around(
    preferred: ComplexArray, *, rows: IntArray, bearings_rad: Array, speeds_mps: Array
) -> tuple[IntArray, ComplexArray]:
    """The best of 36 directions, as a `DetourRule`.

    For a direction at an angle θ to the preferred one let s(θ) be the greatest speed that all bounds allow,
    at most the preferred speed. The robot takes the direction with the largest score

        s(θ) (cos θ + SIDEWAYS), times 1 - RIGHT_HAND to the left,

    at the speed s(θ).
    """
    blocked = np.unique(rows[_approach_speeds(preferred, rows, bearings_rad) > speeds_mps])
    if not blocked.size:
        return blocked, np.zeros(0, dtype=np.complex128)
    theta = np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False)
    directions = np.exp(1j * theta) * (preferred[blocked] / np.abs(preferred[blocked]))[:, None]
    concerned = np.isin(rows, blocked)
    row = np.searchsorted(blocked, rows[concerned])
    cosines = (np.exp(-1j * bearings_rad[concerned])[:, None] * directions[row]).real
    limits = speeds_mps[concerned][:, None] / np.maximum(cosines, MIN_COSINE)
    allowed = np.where(cosines > MIN_COSINE, limits, np.inf)
    speed = np.repeat(np.abs(preferred[blocked])[:, None], DIRECTIONS, axis=1)
    np.minimum.at(speed, row, allowed)
    score = speed * (np.cos(theta) + SIDEWAYS) * np.where(theta > 0, 1 - RIGHT_HAND, 1.0)
    best = np.arange(blocked.size), np.argmax(score, axis=1)
    return blocked, directions[best] * speed[best]


def gyroscopic(
    preferred: ComplexArray, *, rows: IntArray, bearings_rad: Array, speeds_mps: Array
) -> tuple[IntArray, ComplexArray]:
    """A force that turns a robot and does not brake it, as a `DetourRule`; to compare with `around`.

    Gyroscopic forces (Chang, Shadden, Marsden and Olfati-Saber, CDC 2003) turn a robot away from what is
    nearest, at its speed, until it passes: here at once to the tangent of the body whose bound is exceeded
    most, on the side that the preferred direction is nearer to, and to the right if head-on.
    """
    excess = _approach_speeds(preferred, rows, bearings_rad) - speeds_mps
    blocked = np.unique(rows[excess > 0])
    order = np.lexsort((-excess, rows))
    first = order[np.searchsorted(rows[order], blocked)]
    off = wrap_angle(np.angle(preferred[blocked]) - bearings_rad[first])
    quarter = np.where(off > HEAD_ON_RAD, 1j, -1j)
    return blocked, np.abs(preferred[blocked]) * quarter * np.exp(1j * bearings_rad[first])


def out_of_margin(
    preferred: ComplexArray, *, rows: IntArray, bearings_rad: Array, spreads_rad: Array
) -> tuple[IntArray, ComplexArray]:
    """Rows (R,), ascending, and velocities (R,) of robots that have a body within their margin.

    Such a robot may only drive away from it: in directions that stay at a right angle to the body or more,
    whatever its bearing and the robot's heading may turn by until a command takes effect. It takes the one of
    `DIRECTIONS` that is nearest to the preferred one, at the preferred speed. Left out are robots whose
    preferred direction is such a one, and those that have none.

    Args:
        preferred: (N,) preferred velocities in the robots' frames, `forward + i left`, m/s; those of the
            `rows` are not zero.
        rows: (P,) row of the robot of each pair whose bodies are within the margin.
        bearings_rad: (P,) direction to the other body in the robot's frame, positive to the left.
        spreads_rad: (P,) angle by which that direction may be another one.
    """
    concerned, pair_of = np.unique(rows, return_inverse=True)
    theta = np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False)
    along = np.angle(preferred[concerned])

    def leads_away(angles_rad: Array) -> BoolArray:
        """Whether directions (R, M) lead away from all bodies of their robots."""
        off = np.abs(wrap_angle(angles_rad[pair_of] - bearings_rad[:, None]))
        away = np.ones(angles_rad.shape, dtype=bool)
        np.logical_and.at(away, pair_of, off >= np.pi / 2 + spreads_rad[:, None])
        return away

    away = leads_away(along[:, None] + theta)
    score = np.where(away, np.cos(theta) * np.where(theta > 0, 1 - RIGHT_HAND, 1.0), -np.inf)
    best = theta[np.argmax(score, axis=1)]
    turned = away.any(axis=1) & ~leads_away(along[:, None])[:, 0]
    velocities = preferred[concerned] * np.exp(1j * best)
    return concerned[turned], velocities[turned]


def _approach_speeds(velocities: ComplexArray, rows: IntArray, bearings_rad: Array) -> Array:
    """Speeds (P,), m/s, at which robots at velocities (N,) approach the other body of each pair."""
    return np.asarray((np.conj(np.exp(1j * bearings_rad)) * velocities[rows]).real)


Detour = Literal["around", "gyroscopic", "none"]
"""Names of the detour rules in scenario files; with `none` robots only slow down."""

DETOUR_RULES: Mapping[Detour, DetourRule] = {"around": around, "gyroscopic": gyroscopic}
"""The detour rules by their names in scenario files."""
