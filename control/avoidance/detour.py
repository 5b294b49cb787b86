"""Ways around: where a robot goes that is barred from the velocity that it wants."""

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from skyherd.geometry import Array, ComplexArray, IntArray, wrap_angle

DIRECTIONS = 36
SIDEWAYS = 0.2
"""What moving is worth in itself, beside getting on: a robot that faces another slides past it."""
RIGHT_HAND = 0.05
"""By so much is a way to the left worth less: two that meet head on both keep to the right."""


def slide(
    wanted: ComplexArray, rows: IntArray, bearings_rad: Array, speeds_mps: Array
) -> tuple[IntArray, ComplexArray]:
    """Which robots (R,) are barred from the velocity that they want, and the velocity to take instead.

    Of directions at an angle θ to the wanted one, with the speed s(θ) that all bounds allow there, at most
    the wanted one's, the robot takes the one with the largest `s (cos θ + SIDEWAYS)`, a little less if it
    leads to the left.

    Args:
        wanted: (N,) velocities in the robots' frames, forward + i left, m/s.
        rows: (P,) which robot a bound is of.
        bearings_rad: (P,) where the other is.
        speeds_mps: (P,) how fast it may be approached.
    """
    barred = np.unique(rows[_closing(wanted, rows, bearings_rad) > speeds_mps])
    if not barred.size:
        return barred, np.zeros(0, dtype=np.complex128)
    theta = np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False)
    ways = np.exp(1j * theta) * (wanted[barred] / np.abs(wanted[barred]))[:, None]
    mine = np.isin(rows, barred)
    at = np.searchsorted(barred, rows[mine])
    toward = (np.exp(-1j * bearings_rad[mine])[:, None] * ways[at]).real
    allowed = np.where(toward > 1e-9, speeds_mps[mine][:, None] / np.maximum(toward, 1e-9), np.inf)
    speed = np.repeat(np.abs(wanted[barred])[:, None], DIRECTIONS, axis=1)
    np.minimum.at(speed, at, allowed)
    worth = speed * (np.cos(theta) + SIDEWAYS) * np.where(theta > 0, 1 - RIGHT_HAND, 1.0)
    best = np.argmax(worth, axis=1)
    chosen = np.arange(barred.size), best
    return barred, ways[chosen] * speed[chosen]


def circle(
    wanted: ComplexArray, rows: IntArray, bearings_rad: Array, speeds_mps: Array
) -> tuple[IntArray, ComplexArray]:
    """Which robots are barred, and the velocity to take instead, by a force that turns and does not brake.

    Gyroscopic forces (Chang, Shadden, Marsden and Olfati-Saber, CDC 2003) turn a robot away from what is
    nearest, at its speed, until it passes: here at once to the tangent of what bars it most, on the side
    that the wanted direction is nearer to, to the right if head on. Arguments as those of `slide`.
    """
    excess = _closing(wanted, rows, bearings_rad) - speeds_mps
    barred = np.unique(rows[excess > 0])
    order = np.lexsort((-excess, rows))
    first = order[np.searchsorted(rows[order], barred)]
    off = wrap_angle(np.angle(wanted[barred]) - bearings_rad[first])
    turned = np.where(off > RIGHT_HAND, 1j, -1j)
    return barred, np.abs(wanted[barred]) * turned * np.exp(1j * bearings_rad[first])


def _closing(wanted: ComplexArray, rows: IntArray, bearings_rad: Array) -> Array:
    """Speeds (P,) at which robots would come nearer to others."""
    return np.asarray((np.conj(np.exp(1j * bearings_rad)) * wanted[rows]).real)


Way = Callable[[ComplexArray, IntArray, Array, Array], tuple[IntArray, ComplexArray]]
Detour = Literal["around", "gyroscopic", "none"]
WAYS: Mapping[Detour, Way] = {"around": slide, "gyroscopic": circle}
"""By the name that a scenario has for it; with `none` robots only stop."""
