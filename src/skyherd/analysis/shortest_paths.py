"""Shortest paths into a shape with full knowledge: the lower bound for path lengths.

Robots may take any template points, at any position, rotation and size that the mission allows. For a fixed
rotation, the assignment with the least sum of *squared* distances depends on neither size nor position.
`ROTATIONS` of them therefore give candidates, and the best of these are refined with the distances
themselves. Compared with all 120 assignments of five robots, this found the shortest in every test. For six
robots it did so in three of four tests, and was 0.9 % longer otherwise. Forty robots take 0.1 s.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist

from skyherd.control import ascend
from skyherd.geometry import ComplexArray, IntArray, to_points

ROTATIONS = 72
"""Number of tested rotations of the shape, 5 degrees apart. Chosen: time is proportional; half as many miss
more optima."""

REFINED = 12
"""Number of assignments that are refined, best first. Chosen: time is proportional; fewer miss optima."""

ROUNDS = 500
"""Maximum number of reweighting rounds. Iteration stops when the sum improves by less than `TOLERANCE`."""

TOLERANCE = 1e-10
"""Relative change of the sum that ends the iteration. Chosen: far above float64 rounding, 1e-16, and far
below the required precision of a path length."""

MIN_DISTANCE = 1e-9
"""Least distance in the weights 1 / distance, as a share of the starts' extent. It keeps the weight finite
for a robot that starts at its end point."""


@dataclass(frozen=True)
class ShortestPath:
    """Least sum of straight distances found, with its assignment and end points.

    Attributes:
        length: sum of the distances, in the starts' unit.
        order: (N,) template point of each robot.
        places: (N,) end points of the robots, `a template[order] + b`.
    """

    length: float
    order: IntArray
    places: ComplexArray


def shortest_path(
    template: ComplexArray,
    starts: ComplexArray,
    *,
    classes: IntArray | None = None,
    spacing: tuple[float, float] = (0.0, np.inf),
) -> ShortestPath:
    """Minimise `Σ_i |a p_σ(i) + b - x_i|` over assignments σ and similarities (a, b), a ≠ 0.

    For a fixed rotation φ, the assignment with the least *squares* depends on neither size nor position: it
    maximises `Re(e^{-iφ} Σ conj(p_σ(i)) x_i)`. Sampled rotations give candidates. Each candidate alternates
    between its best rotation and the best assignment for that rotation.

    The best candidates are refined with the distances themselves: similarity by iteratively reweighted least
    squares, then assignment, until neither shortens the sum. For one σ and free size the sum is convex in (a,
    b). Only the choice of σ may therefore miss the optimum: the result is never below it, and seldom above.

    Args:
        template: p (N,), in the sense of the starts.
        starts: x (N,).
        classes: (N,) only robots of one class exchange their points; all may if None.
        spacing: least and greatest distance of the shape's two nearest points, in the starts' unit.
    """
    classes = np.zeros(starts.size, dtype=np.int64) if classes is None else classes
    groups = [np.flatnonzero(classes == label) for label in np.unique(classes)]
    nearest = float(pdist(to_points(template)).min())
    sizes = spacing[0] / nearest, spacing[1] / nearest
    found = [
        _follow_up(template, starts, order, groups, sizes)
        for order in _choice(template, starts, classes)[:REFINED]
    ]
    return min(found, key=lambda path: path.length)


def _assign(costs: np.ndarray, groups: list[IntArray]) -> IntArray:
    """Return the template point (N,) of each robot with the least cost (robot, point) within classes."""
    order: IntArray = np.arange(len(costs))
    for rows in groups:
        if rows.size > 1:
            # Imported here: it takes 0.2 s, and most runs do not need it.
            from scipy.optimize import linear_sum_assignment

            order[rows] = rows[linear_sum_assignment(costs[np.ix_(rows, rows)])[1]]
    return order


def _choice(template: ComplexArray, starts: ComplexArray, classes: IntArray) -> list[IntArray]:
    """Return different assignments, least squares first, none of which turns into another."""
    if np.unique(classes).size == classes.size:
        return [np.arange(starts.size)]
    points, robots = template - template.mean(), starts - starts.mean()
    reached: dict[bytes, tuple[float, IntArray]] = {}
    for turn in np.exp(2j * np.pi * np.arange(ROTATIONS) / ROTATIONS):
        order, z = ascend(robots, points, turn, classes=classes)
        reached.setdefault(order.tobytes(), (abs(z), order))
    return [order for _, order in sorted(reached.values(), key=lambda item: -item[0])]


def _follow_up(
    template: ComplexArray,
    starts: ComplexArray,
    order: IntArray,
    groups: list[IntArray],
    sizes: tuple[float, float],
) -> ShortestPath:
    """Refine similarity and assignment in turn, by the distances themselves, until convergence."""
    best: ShortestPath | None = None
    while True:
        a, b = _nearest_similarity(template[order], starts, sizes)
        places = a * template + b
        path = ShortestPath(float(np.abs(places[order] - starts).sum()), order, places[order])
        if best is not None and path.length >= best.length * (1 - TOLERANCE):
            return best
        best = path
        order = _assign(np.abs(starts[:, None] - places[None]), groups)


def _nearest_similarity(
    points: ComplexArray, starts: ComplexArray, sizes: tuple[float, float]
) -> tuple[complex, complex]:
    """Return (a, b), |a| within `sizes`, with least `Σ |a p + b - x|`, by reweighted least squares.

    The weighted squares are `const + W |a - a0|²` in a, so that the best a within `sizes` is the nearest to
    a0 along its own direction.
    """
    weights, length = np.ones(starts.size), np.inf
    least = MIN_DISTANCE * (np.ptp(starts.real) + np.ptp(starts.imag))
    for _ in range(ROUNDS):
        share = weights / weights.sum()
        point, start = share @ points, share @ starts
        arms = points - point
        a = complex((share * arms.conj()) @ (starts - start) / (share @ np.abs(arms) ** 2))
        if not sizes[0] <= abs(a) <= sizes[1]:
            a = float(np.clip(abs(a), *sizes)) * (a / abs(a) if a else 1.0)
        b = complex(start - a * point)
        distances = np.abs(a * points + b - starts)
        total = float(distances.sum())
        if total >= length * (1 - TOLERANCE):
            break
        length, weights = total, 1 / np.maximum(distances, least)
    return a, b
