"""Who goes where: the assignment of robots to template points that leaves least to do.

With centred robots x and points p, and c(i) the point of robot i, the least-squares similarity leaves

    J = Σ |x_i|² - |Z|² / Σ |p_i|²,    Z = Σ conj(p_c(i)) x_i,

so that the best map is the one with the largest |Z|. For a given rotation φ the best map maximises
Re(e^{-iφ} Z), an assignment problem in which size and place have no part; assigning and rotating in turn
never lowers |Z|. It ends at a local maximum; starts all around the circle find the others.
"""

import numpy as np
from scipy.optimize import linear_sum_assignment

from skyherd.geometry import ComplexArray, IntArray

TURNS = 30
"""Assigning and rotating in turn ends after a few; this is a guard."""


def correlation(robots: ComplexArray, points: ComplexArray) -> complex:
    """Z of robots (M,) at the points (M,) that are theirs, both centred."""
    return complex(np.vdot(points - points.mean(), robots - robots.mean()))


def assign(robots: ComplexArray, points: ComplexArray, turn: complex, classes: IntArray) -> IntArray:
    """The map c (M,) that maximises Re(conj(turn) Σ conj(p_c(i)) x_i); c(i) is of robot i's class."""
    order = np.arange(robots.size)
    for kind in np.unique(classes):
        of_kind = np.flatnonzero(classes == kind)
        worth = (np.conj(turn * points[of_kind])[None, :] * robots[of_kind][:, None]).real
        _, columns = linear_sum_assignment(worth, maximize=True)
        order[of_kind] = of_kind[columns]
    return order


def best_assignment(
    robots: ComplexArray, points: ComplexArray, classes: IntArray, *, starts: int = 0
) -> IntArray:
    """The best map c (M,) found, `points[c]` in the robots' order; the present one is the identity.

    Args:
        robots: (M,) where robots are.
        points: (M,) the points they have now, those of all classes in this order.
        classes: (M,) robots exchange points within their class.
        starts: rotations to begin at, evenly spread, besides the present one.
    """
    x, p = robots - robots.mean(), points - points.mean()
    best = np.arange(robots.size)
    best_z = np.vdot(p, x)
    turns = [best_z, *np.exp(2j * np.pi * np.arange(starts) / max(starts, 1))]
    for turn in turns:
        order, z = ascend(x, p, turn, classes)
        if abs(z) > abs(best_z):
            best, best_z = order, z
    return best


def ascend(x: ComplexArray, p: ComplexArray, turn: complex, classes: IntArray) -> tuple[IntArray, complex]:
    """The map (M,) that assigning and rotating in turn end at, from a rotation on, and its Z; all centred."""
    order, z = np.arange(x.size), turn
    for _ in range(TURNS):
        turn = z / abs(z) if z else 1.0
        before, order = order, assign(x, p, turn, classes)
        z = complex(np.vdot(p[order], x))
        if np.array_equal(order, before):
            break
    return order, z
