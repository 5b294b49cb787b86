"""Crowded starts with random roles: nobody touches, and the shape comes; with the parts off they do touch."""

import argparse
import importlib.util
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture(scope="module")
def benchmark():
    """`benchmarks/bodies.py` as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
        spec = importlib.util.spec_from_file_location("bodies_benchmark", BENCHMARKS / "bodies.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        yield module


def options(**changed) -> argparse.Namespace:
    usual = {"start": "crowded", "perception": "noisy", "network": "perfect", "kill": False, "without": []}
    return argparse.Namespace(**(usual | changed))


@pytest.mark.parametrize("seed", [0, 3, 6, 13])
def test_a_crowd_reaches_its_shape_and_nobody_touches(benchmark, seed) -> None:
    """One to three units; what the benchmark does a thousand times. 1.5 is beyond its 99 % quantile."""
    row = benchmark.run_mission(seed, options())
    assert row["converged"] and row["collisions"] == 0
    assert row["min_gap_sides"] > 0.2, "the margin"
    assert row["path_m"] < 1.5 * row["shortest_m"]


@pytest.mark.parametrize("changed", [{"network": "lossy"}, {"kill": True}])
def test_lost_messages_and_a_death_change_nothing_of_that(benchmark, changed) -> None:
    row = benchmark.run_mission(10, options(**changed))
    assert row["units"] == 3 and row["converged"] and row["collisions"] == 0


def test_fixed_roles_are_slower_and_still_nobody_touches(benchmark) -> None:
    free, fixed = (benchmark.run_mission(4, options(without=without)) for without in ([], ["roles"]))
    assert fixed["converged"] and fixed["collisions"] == 0
    assert fixed["time_to_1pct_s"] > 1.5 * free["time_to_1pct_s"]
    assert fixed["path_m"] > 2 * free["path_m"]


@pytest.mark.parametrize("seed", [0, 4])
def test_points_with_fixed_roles_drive_into_one_another(benchmark, seed) -> None:
    """Negative control: what the parts are for."""
    row = benchmark.run_mission(seed, options(without=["roles", "size", "avoidance"]))
    assert row["collisions"] > 0 and row["min_gap_sides"] < -1
