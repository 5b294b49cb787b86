"""Size of the shape: the best fit within bounds, equal for all units, and robots that reach it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.distance import pdist

from skyherd.control import SizeRule, Template, fit_similarity
from skyherd.control.formation.size import LEAK, SideConsensus
from skyherd.datasets import make_mission
from skyherd.loop import run_steps


def draw(seed: int, count: int = 7) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng([seed, 3])
    return tuple(rng.normal(size=(2, count)) + 1j * rng.normal(size=(2, count)))


def residual(turn: complex, points, robots) -> float:
    p, x = points - points.mean(), robots - robots.mean()
    return float(np.sum(np.abs(turn * p - x) ** 2))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("low", "high"), [(0.8, np.inf), (0.0, 0.1), (0.5, 0.5)])
def test_resized_similarity_is_best_fit_within_bounds(seed, low, high) -> None:
    """The reference is a numerical search over size and rotation, with starts all around."""
    points, robots = draw(seed)
    fitted = fit_similarity(points, robots).resized(low, high)
    assert low - 1e-12 <= fitted.scale <= high + 1e-12

    def cost(unknowns) -> float:
        scale = min(max(abs(unknowns[0]), low), high)
        return residual(scale * np.exp(1j * unknowns[1]), points, robots)

    starts = [(0.7, angle) for angle in np.linspace(-3, 3, 7)]
    best = min(minimize(cost, start, method="Nelder-Mead", tol=1e-10).fun for start in starts)
    assert residual(fitted.factor, points, robots) == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_bounded_goals_equal_gradient_of_lyapunov_function(seed) -> None:
    """Lemma 2 with an active bound: dV/dx = x - d, by central differences (error of second order)."""
    points, robots = draw(seed)
    low = 2 * fit_similarity(points, robots).scale

    def cost(x) -> float:
        fitted = fit_similarity(points, x).resized(low, np.inf)
        return float(np.sum(np.abs(fitted(points) - x) ** 2) / 2)

    fitted = fit_similarity(points, robots).resized(low, np.inf)
    step = 1e-5
    for robot in range(robots.size):
        for way in (1, 1j):
            moved = [robots + sign * step * way * (np.arange(robots.size) == robot) for sign in (1, -1)]
            slope = (cost(moved[0]) - cost(moved[1])) / (2 * step)
            away = robots[robot] - fitted(points)[robot]
            assert slope == pytest.approx((away * np.conj(way)).real, abs=1e-7)


def test_size_bounds_scale_with_nearest_point_distance() -> None:
    template = Template(np.arange(3), np.array([0, 10, 35j]))
    assert SizeRule(3.0, 6.0).scales(template, 20.0) == (6.0, 12.0)
    assert SizeRule().is_free and SizeRule().scales(template, 20.0) == (0.0, np.inf)


@pytest.mark.parametrize("units", [2, 4])
def test_side_consensus_reduces_disagreement(make_detections, make_report, units) -> None:
    """A chain of units, each 2 % off its neighbour, in images of different scale.

    The agreed sides differ by a share of the differences of the measured ones; the share falls with LEAK.
    """
    rng = np.random.default_rng(4)
    ground = rng.normal(size=6) + 1j * rng.normal(size=6)
    scales, errors = rng.uniform(100, 300, units), 1 + 0.02 * np.arange(units)
    estimates = [SideConsensus() for _ in range(units)]
    seen = [
        make_detections(np.arange(6), scale * ground, sides=np.full(6, 0.2 * scale * error), unit_id=unit)
        for unit, (scale, error) in enumerate(zip(scales, errors, strict=True))
    ]
    reports: dict = {}
    for _ in range(200):
        sides = [
            estimate.update(seen[unit], [reports[k] for k in (unit - 1, unit + 1) if k in reports])
            for unit, estimate in enumerate(estimates)
        ]
        for unit, side in enumerate(sides):
            report = make_report(unit, np.arange(6), scales[unit] * ground, [])
            reports[unit] = replace(report, side_px=side)
    agreed = np.array(sides) / scales
    assert np.ptp(np.log(agreed)) < 2 * LEAK * units * np.ptp(np.log(errors))
    assert agreed.mean() == pytest.approx(0.2 * errors.mean(), rel=0.02 * units)


@pytest.mark.parametrize(
    ("size", "spacing_sides"),
    [({}, None), ({"min_spacing_sides": 6.0}, 6.0), ({"spacing_sides": 2.0}, 2.0), ({"unit_m": 0.4}, 0.8)],
)
@pytest.mark.parametrize(
    ("step_s", "rectify"), [(0.2, False), pytest.param(0.1, True, marks=pytest.mark.slow)]
)
def test_team_reaches_bounded_or_given_size(scenario_tree, size, spacing_sides, step_s, rectify) -> None:
    """The triangle with permuted roles shrinks to 3.5 sides without a bound; a side is 0.5 m."""
    tree = scenario_tree("triangle") | {
        "perception": "ideal",
        "duration_s": 40.0,
        "step_s": step_s,
        "size": size,
    }
    tree["units"][0]["frame_rate_hz"] = 1 / step_s
    tree["robots"]["positions_m"] = [tree["robots"]["positions_m"][i] for i in (3, 1, 5, 0, 4, 2)]
    tree["control"] |= {"b_th": 0.0, "k": 0.3, "k_omega": 1.2, "rectify": rectify}
    *_, last = run_steps(make_mission(tree))
    nearest_sides = pdist(last.positions_m).min() / 0.5
    assert last.metrics.shape.error < 0.01
    if spacing_sides is None:
        assert 3.0 < nearest_sides < 4.0
    else:
        assert nearest_sides == pytest.approx(spacing_sides, rel=0.01)


def test_side_consensus_leaks_a_twentieth_of_the_mean(make_detections, make_report) -> None:
    """From equal images, a neighbour's side of 24 px moves the side of 20 px by 0.95 of the half."""
    points = [0, 100, 100j]
    report = replace(make_report(1, [0, 1, 2], points, [0]), side_px=24.0)
    side_px = SideConsensus().update(make_detections([0, 1, 2], points), [report])
    assert side_px == pytest.approx(20 * 1.2 ** (0.95 / 2))
