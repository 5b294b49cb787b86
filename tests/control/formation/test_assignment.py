"""Role assignment: the best map is found under any similarity, and straight paths under it do not cross."""

from itertools import permutations

import numpy as np
import pytest

from skyherd.control.formation.assignment import best_assignment, correlation

ALIKE = np.zeros(6, dtype=int)


def draw(seed: int, count: int = 6) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng([seed, 1])
    return tuple(rng.normal(size=(2, count)) + 1j * rng.normal(size=(2, count)))


@pytest.mark.parametrize("seed", range(20))
def test_assignment_is_best_of_all_maps(seed) -> None:
    robots, points = draw(seed)
    found = best_assignment(robots, points, ALIKE, starts=24)
    best = max(abs(correlation(robots, points[list(order)])) for order in permutations(range(6)))
    assert abs(correlation(robots, points[found])) == pytest.approx(best, rel=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_assignment_never_increases_residual(seed) -> None:
    """The search starts from the present map alone."""
    robots, points = draw(seed, 30)
    found = best_assignment(robots, points, np.zeros(30, dtype=int))
    assert abs(correlation(robots, points[found])) >= abs(correlation(robots, points))


def test_assignment_is_invariant_to_similarity() -> None:
    robots, points = draw(3)
    map_ = best_assignment(robots, points, ALIKE, starts=24)
    moved = 3.7 * np.exp(2.1j) * robots + (50 - 20j)
    assert best_assignment(moved, points, ALIKE, starts=24).tolist() == map_.tolist()
    assert best_assignment(robots, 0.2 * points - 4j, ALIKE, starts=24).tolist() == map_.tolist()


def test_assignment_keeps_classes() -> None:
    robots, points = draw(4)
    classes = np.array([0, 0, 0, 1, 1, 1])
    found = best_assignment(robots, points, classes, starts=24)
    assert sorted(found[:3].tolist()) == [0, 1, 2] and sorted(found[3:].tolist()) == [3, 4, 5]
    alone = best_assignment(robots, points, np.arange(6), starts=24)
    assert alone.tolist() == list(range(6))


@pytest.mark.parametrize("seed", range(10))
def test_assigned_straight_paths_keep_distance(seed) -> None:
    """Under a best assignment (Δx, Δd) >= 0 for every two robots. From start x to goal d

        |Δ(t)|² >= (1-t)² |Δx|² + t² |Δd|²,

    so the minimum distance is at least min(|Δx|, |Δd|) / sqrt(2).
    """
    robots, points = draw(seed, 12)
    points = points[best_assignment(robots, points, np.zeros(12, dtype=int), starts=24)]
    p, x = points - points.mean(), robots - robots.mean()
    goals = np.vdot(p, x) / np.vdot(p, p).real * p
    apart = [robots[:, None] - robots, goals[:, None] - goals]
    upper = np.triu_indices(12, 1)
    start, end = (np.abs(z[upper]) for z in apart)
    assert ((apart[0] * apart[1].conj()).real[upper] >= -1e-9).all()
    for t in np.linspace(0, 1, 21):
        there = np.abs((1 - t) * apart[0] + t * apart[1])[upper]
        assert (there >= np.minimum(start, end) / np.sqrt(2) - 1e-9).all()
