"""Crowded starts with random roles: no collisions and convergence; without the measures robots collide."""

import argparse

import pytest


@pytest.fixture(scope="module")
def benchmark(load_benchmark):
    """Return `benchmarks/bodies.py` as a module."""
    return load_benchmark("bodies")


def options(**changed) -> argparse.Namespace:
    usual = {
        "start": "crowded",
        "perception": "noisy",
        "network": "perfect",
        "kill": False,
        "without": [],
        "drive": [],
    }
    return argparse.Namespace(**(usual | changed))


@pytest.mark.parametrize("seed", [0, 13, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (3, 6))])
def test_crowd_reaches_shape_without_collision(benchmark, seed) -> None:
    """One to three units, as in the benchmark's thousand runs. 1.5 is beyond its 99 % quantile."""
    row = benchmark.run_mission(seed, options())
    assert row["converged"] and row["collisions"] == 0
    assert row["min_gap_sides"] > 0.2, "the margin"
    assert row["path_m"] < 1.5 * row["shortest_m"]


@pytest.mark.parametrize("changed", [{"network": "lossy"}, {"kill": True}])
def test_crowd_is_safe_under_message_loss_and_unit_failure(benchmark, changed) -> None:
    row = benchmark.run_mission(10, options(**changed))
    assert row["units"] == 3 and row["converged"] and row["collisions"] == 0


def test_crowd_with_fixed_roles_is_slower_but_safe(benchmark) -> None:
    free, fixed = (benchmark.run_mission(4, options(without=without)) for without in ([], ["roles"]))
    assert fixed["converged"] and fixed["collisions"] == 0
    assert fixed["time_to_1pct_s"] > 1.5 * free["time_to_1pct_s"]
    assert fixed["path_m"] > 2 * free["path_m"]


@pytest.mark.parametrize("seed", [0, pytest.param(4, marks=pytest.mark.slow)])
def test_point_robots_with_fixed_roles_collide(benchmark, seed) -> None:
    """Negative control: the purpose of the measures."""
    row = benchmark.run_mission(seed, options(without=["roles", "size", "avoidance"]))
    assert row["collisions"] > 0 and row["min_gap_sides"] < -1
