"""Detours: velocities of robots whose preferred velocity is blocked by nearby bodies.

A detour rule affects progress only. The bound on the approach speed is applied afterwards and ensures safety
(`skyherd.control.avoidance.speed_bound`). A rule may therefore return any velocity.
"""

from collections.abc import Mapping
from typing import Literal, Protocol

import numpy as np

from skyherd.geometry import Array, ComplexArray, IntArray, wrap_angle

DIRECTIONS = 36
"""Number of directions that `around` compares, evenly spread: one per 10 degrees. Chosen: cost is
proportional."""

SIDEWAYS = 0.2
"""Score of motion itself, added to the cosine that scores progress. Chosen: above 0, so that a robot can
slide past an obstacle at 90 degrees; larger values accept longer detours."""

RIGHT_HAND = 0.05
"""Relative penalty of directions to the left. Chosen: it breaks the tie between left and right, so that two
robots that meet head-on both keep right."""

HEAD_ON_RAD = 0.05
"""Angle up to which `gyroscopic` treats an encounter as head-on and passes right, rad. Chosen: 3 degrees."""

MIN_COSINE = 1e-9
"""A direction with a smaller cosine to a body does not approach it. Chosen: above the rounding error of a
cosine (1e-16); the remaining approach is negligible and is bounded afterwards."""


class DetourRule(Protocol):
    """Interface of a rule that finds other velocities for robots whose preferred velocities are blocked."""

    def __call__(
        self, preferred: ComplexArray, *, rows: IntArray, bearings_rad: Array, speeds_mps: Array
    ) -> tuple[IntArray, ComplexArray]:
        """Return the rows (R,) of the blocked robots, ascending, and their alternative velocities (R,).

        A robot is blocked if its preferred velocity approaches some body faster than the bound allows. Other
        robots must not be among the rows: they follow the paper's law exactly.

        Args:
            preferred: (N,) preferred velocities in the robots' frames, `forward + i left`, m/s.
            rows: (P,) row of the robot of each bound.
            bearings_rad: (P,) direction to the other body in the robot's frame, positive to the left.
            speeds_mps: (P,) maximum approach speed.
        """
        ...


def around(
    preferred: ComplexArray, *, rows: IntArray, bearings_rad: Array, speeds_mps: Array
) -> tuple[IntArray, ComplexArray]:
    """Return the best of 36 directions for each blocked robot, as a `DetourRule`.

    For a direction at an angle θ to the preferred one let s(θ) be the maximum speed that all bounds allow, at
    most the preferred speed. The robot takes the direction with the largest score

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
    """Return velocities turned by a gyroscopic force, as a `DetourRule`; for comparison with `around`.

    Gyroscopic forces (Chang, Shadden, Marsden and Olfati-Saber, CDC 2003) turn a robot away from the nearest
    body without braking. Here the robot turns at once to the tangent of the body whose bound is exceeded
    most. It takes the side nearer to the preferred direction, or the right side if head-on.
    """
    excess = _approach_speeds(preferred, rows, bearings_rad) - speeds_mps
    blocked = np.unique(rows[excess > 0])
    order = np.lexsort((-excess, rows))
    first = order[np.searchsorted(rows[order], blocked)]
    off = wrap_angle(np.angle(preferred[blocked]) - bearings_rad[first])
    quarter = np.where(off > HEAD_ON_RAD, 1j, -1j)
    return blocked, np.abs(preferred[blocked]) * quarter * np.exp(1j * bearings_rad[first])


def nearest(
    preferred: ComplexArray, *, rows: IntArray, bearings_rad: Array, speeds_mps: Array
) -> tuple[IntArray, ComplexArray]:
    """Return the velocities nearest to the preferred ones that all bounds allow, as a `DetourRule`.

    With the bounds `Re(e^{-iβ} u) <= b` as control barrier functions this is the filter of Wang, Ames and
    Egerstedt (Wang 2017), a quadratic program. Standstill satisfies all bounds. Robots that meet head-on
    stand still; for comparison with `around`.
    """
    blocked = np.unique(rows[_approach_speeds(preferred, rows, bearings_rad) > speeds_mps])
    velocities = preferred[blocked].copy()
    for at, robot in enumerate(blocked.tolist()):
        own = rows == robot
        velocities[at] = _project(velocities[at], bearings_rad[own], np.maximum(speeds_mps[own], 0.0))
    return blocked, velocities


def _project(velocity: complex, bearings_rad: Array, speeds_mps: Array) -> complex:
    """Return the point nearest to a velocity with `Re(e^{-iβ_k} u) <= b_k` for all k.

    Least-distance programming by non-negative least squares (Lawson and Hanson 1974, chapter 23): with the
    residual r of `min |E y - f|` over `y >= 0`, the offset is `-(r_1, r_2) / r_3`.
    """
    # Imported here, since it takes 0.2 s and most runs do not need it.
    from scipy.optimize import nnls

    towards = np.exp(1j * bearings_rad)
    slack = speeds_mps - (towards.conj() * velocity).real
    matrix = np.stack([-towards.real, -towards.imag, -slack])
    solution, _ = nnls(matrix, np.array([0.0, 0.0, 1.0]))
    residual = matrix @ solution - (0.0, 0.0, 1.0)
    if abs(residual[2]) < MIN_COSINE:
        return 0j
    offset = -residual[:2] / residual[2]
    return velocity + complex(offset[0], offset[1])


def _approach_speeds(velocities: ComplexArray, rows: IntArray, bearings_rad: Array) -> Array:
    """Return the approach speeds (P,), m/s, of robots at velocities (N,) to the other body of each pair."""
    return np.asarray((np.conj(np.exp(1j * bearings_rad)) * velocities[rows]).real)


Detour = Literal["around", "gyroscopic", "nearest", "none"]
"""Names of the detour rules in scenario files; with `none` robots only slow down."""

DETOUR_RULES: Mapping[Detour, DetourRule] = {"around": around, "gyroscopic": gyroscopic, "nearest": nearest}
"""The detour rules by their names in scenario files."""
