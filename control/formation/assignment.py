"""Assignment of robots to template points that minimises the residual of the best-fitting similarity.

Let x_i be the robots' positions and p_c(i) the template point of robot i, complex and centred. The residual
of the least-squares similarity (`skyherd.control.formation.similarity`) is

    J = Σ |x_i|² - |Z|² / Σ |p_i|²,    Z = Σ conj(p_c(i)) x_i.

The best map c therefore has the largest |Z|. For a given rotation φ the best map maximises Re(e^{-iφ} Z).
That is a linear assignment problem, independent of size and position of the shape. The search alternates
between the best map for a rotation and the best rotation φ = arg Z for the map. This never lowers |Z| and
ends at a local maximum. Starts from rotations all around the circle find the others.
"""

import numpy as np

from skyherd.geometry import ComplexArray, IntArray
from skyherd.messages.checks import check_vectors

MAX_ITERATIONS = 30
"""Maximum number of alternations from one start. Chosen: each raises |Z| or ends the search; a few suffice.
Maximum number of alternations from one start. Chosen: each raises |Z| or ends the search; a few suffice."""


def correlation(robots: ComplexArray, points: ComplexArray) -> complex:
    """Return Z of robots (M,) and their template points (M,); both are centred here."""
    return complex(np.vdot(points - points.mean(), robots - robots.mean()))


def assign(robots: ComplexArray, points: ComplexArray, rotation: complex, *, classes: IntArray) -> IntArray:
    """Return the map c (M,) that maximises Re(conj(rotation) Σ conj(p_c(i)) x_i) within the classes.

    Args:
        robots: (M,) centred positions of the robots.
        points: (M,) centred template points.
        rotation: e^{iφ}; its magnitude has no effect.
        classes: (M,) class of each robot and of the point in the same row; c(i) is of robot i's class.
    """
    check_vectors("assign", robots=robots, points=points, classes=classes)
    # Imported here, since it takes 0.2 s and most runs do not need it.
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
    """Search for the map c (M,) with the largest |Z|: robot i takes the point `points[c[i]]`.

    The search starts from the best rotation for the present map, and from `starts` others. Without an
    improvement it returns the present map, the identity.

    Args:
        robots: (M,) positions of the robots.
        points: (M,) present template points of the robots, in the robots' order.
        classes: (M,) class of each robot; points are exchanged within a class only.
        starts: number of further start rotations, evenly spread over the circle.
    """
    check_vectors("best_assignment", robots=robots, points=points, classes=classes)
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
    """Alternate assignment and rotation until convergence; return the map (M,) and its Z.

    Args:
        x: (M,) centred positions of the robots.
        p: (M,) centred template points.
        rotation: start value, e^{iφ} times any positive number.
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
