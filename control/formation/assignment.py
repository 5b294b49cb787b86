"""The assignment of robots to template points under which the best-fitting similarity fits best.

Let x_i be the robots' places and p_c(i) the template point of robot i, complex and centred. The least-squares
similarity (`skyherd.control.formation.similarity`) leaves the sum of squared distances

    J = Σ |x_i|² - |Z|² / Σ |p_i|²,    Z = Σ conj(p_c(i)) x_i,

so that the best map c is the one with the largest |Z|. For a given rotation φ the best map maximises
Re(e^{-iφ} Z), which is a linear assignment problem in which neither size nor place of the shape matters.
Alternating the two, that is, the best map for a rotation and then the best rotation φ = arg Z for the map,
never lowers |Z| and ends at a local maximum; starts from rotations all around the circle find the others.
"""

import numpy as np

from skyherd.geometry import ComplexArray, IntArray
from skyherd.messages.checks import check_vectors

MAX_ITERATIONS = 30
"""Limit of the alternations from one start. Chosen: each raises |Z| or ends the search, and a few suffice."""


def correlation(robots: ComplexArray, points: ComplexArray) -> complex:
    """Z of robots (M,) and their template points (M,), both of which are centred here."""
    return complex(np.vdot(points - points.mean(), robots - robots.mean()))


def assign(robots: ComplexArray, points: ComplexArray, rotation: complex, *, classes: IntArray) -> IntArray:
    """The map c (M,) that maximises Re(conj(rotation) Σ conj(p_c(i)) x_i) within the classes.

    Args:
        robots: (M,) centred places of the robots.
        points: (M,) centred template points.
        rotation: e^{iφ}; its length does not matter.
        classes: (M,) class of each robot and of the point in the same row; c(i) is of robot i's class.
    """
    # Imported where it is needed: it takes 0.2 s, and most runs do without.
    from scipy.optimize import linear_sum_assignment

    order = np.arange(robots.size)
    for robot_class in np.unique(classes):
        rows = np.flatnonzero(classes == robot_class)
        benefits = (np.conj(rotation * points[rows])[None, :] * robots[rows][:, None]).real
        _, columns = linear_sum_assignment(benefits, maximize=True)
        order[rows] = rows[columns]
    return order


def best_assignment(
    robots: ComplexArray, points: ComplexArray, classes: IntArray, *, starts: int = 0
) -> IntArray:
    """The map c (M,) with the largest |Z| that was found: robot i is to take the point `points[c[i]]`.

    The search starts from the rotation that fits the present map best, and from `starts` others. The present
    map, which is the identity, is returned where nothing better is found.

    Args:
        robots: (M,) places of the robots.
        points: (M,) the template points that the robots have now, in the robots' order.
        classes: (M,) class of each robot; points are exchanged within a class only.
        starts: number of further rotations to start from, evenly spread over the circle.
    """
    x, p = robots - robots.mean(), points - points.mean()
    best = np.arange(robots.size)
    best_z = np.vdot(p, x)
    rotations = [best_z, *np.exp(2j * np.pi * np.arange(starts) / max(starts, 1))]
    for rotation in rotations:
        order, z = ascend(x, p, rotation, classes=classes)
        if abs(z) > abs(best_z):
            best, best_z = order, z
    return best


def ascend(
    x: ComplexArray, p: ComplexArray, rotation: complex, *, classes: IntArray
) -> tuple[IntArray, complex]:
    """The map (M,) at which assigning and rotating in turn end, and its Z.

    Args:
        x: (M,) centred places of the robots.
        p: (M,) centred template points.
        rotation: where to start, e^{iφ} times any positive length.
        classes: (M,) class of each robot.
    """
    check_vectors("ascend", x=x, p=p, classes=classes)
    order, z = np.arange(x.size), rotation
    for _ in range(MAX_ITERATIONS):
        rotation = z / abs(z) if z else 1.0
        before, order = order, assign(x, p, rotation, classes=classes)
        z = complex(np.vdot(p[order], x))
        if np.array_equal(order, before):
            break
    return order, z
