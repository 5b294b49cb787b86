"""Overlapping sets with a fallback: the tree starts after they have failed, and not before."""

from dataclasses import replace

import numpy as np
import pytest

from skyherd.control import HybridSelection, Template, TreeProtocol
from skyherd.control.goals import lyapunov_term
from skyherd.datasets import make_mission
from skyherd.datasets.generated.random_missions import random_mission
from skyherd.loop import run_steps

TEMPLATE = Template.from_image_points([0, 1, 2, 3], [[0, 0], [1, 0], [1, 1], [0, 1]])


@pytest.fixture
def one_unit(make_report, make_detections):
    """Return the start time of the tree, s, or None, of a unit that reports Lyapunov terms at 1 Hz.

    The tree starts with the image after the report that shows the failure, one second later.
    """

    def run(cost, controlled=(0, 1, 2, 3), until_s: int = 40) -> int | None:
        policy, last = HybridSelection(stall_s=10.0), None
        seen = make_detections([0, 1, 2, 3], [300 + 300j, 400 + 300j, 400 + 400j, 300 + 400j])
        report = make_report(0, list(controlled), [0] * len(controlled), list(controlled))
        for time_s in range(until_s):
            policy.choose(replace(seen, time_s=time_s), [], TEMPLATE, last)
            if policy.tree is not None:
                return time_s - 1
            last = replace(report, time_s=time_s, cost_sides2=cost(time_s))
        return None

    return run


def test_falling_lyapunov_value_keeps_overlapping_sets(one_unit) -> None:
    assert one_unit(lambda t: 100 * np.exp(-0.02 * t)) is None


@pytest.mark.smoke
def test_stalled_lyapunov_value_starts_tree(one_unit) -> None:
    """The first comparison is with an image more than 10 s old."""
    assert one_unit(lambda t: 5.0) == 11


@pytest.mark.parametrize(("after", "start_s"), [(95.0, None), (95.1, 11)])
def test_lyapunov_value_must_fall_by_share_of_progress(one_unit, after, start_s) -> None:
    """From 100, a fall by 5 % within 10 s is progress, and less is none."""
    assert one_unit(lambda t: 100.0 if t < 5 else after, until_s=13) == start_s


def test_lyapunov_value_at_floor_is_no_stall(one_unit) -> None:
    """All four robots 0.1 sides from their goals make V = 4 · 0.1² / 2; half of that is within the floor."""
    assert one_unit(lambda t: 0.01) is None
    assert one_unit(lambda t: 0.03) == 11


def test_uncontrolled_robot_starts_tree(one_unit) -> None:
    assert one_unit(lambda t: 0.0, controlled=(0, 1, 2)) == 11


def test_unit_follows_started_tree(make_report, make_detections) -> None:
    follower, leader = HybridSelection(stall_s=10.0), TreeProtocol()
    seen = make_detections([0, 1, 2, 3], [300 + 300j, 400 + 300j, 400 + 400j, 300 + 400j])
    report = make_report(1, [0], [400 + 400j], [])
    for reports in ([], [report]):
        selection = follower.choose(seen, reports, TEMPLATE, None)
        assert selection.controlled_ids.tolist() == [0, 1, 2, 3] and selection.tree_status is None
    status = leader.choose(replace(seen, unit_id=1), [], TEMPLATE, None).tree_status
    selection = follower.choose(seen, [replace(report, tree=status)], TEMPLATE, None)
    assert selection.controlled_ids.tolist() == []
    assert not selection.may_move and selection.tree_status is not None


def test_lyapunov_term_is_half_squares_in_marker_sides(make_goals) -> None:
    assert lyapunov_term(None) == 0.0
    assert lyapunov_term(make_goals(0, [0, 1], [3, 4j], sides=[1.0, 2.0])) == pytest.approx((9 + 4) / 2)


def test_tree_saves_mission_lost_by_overlapping_sets() -> None:
    """Hovering units with a small radius lose robots: the shape is reached only with the tree."""
    errors = {}
    for kind in ("radius", "radius-then-tree"):
        tree = random_mission(3) | {"perception": "ideal", "duration_s": 60.0}
        tree["selection"] = {"kind": kind, "radius": 0.8}
        tree.setdefault("control", {})["rectify"] = False
        for unit in tree["units"]:
            unit["flight"] = {"kind": "hover"}
        for step in run_steps(make_mission(tree)):
            errors[kind] = step.metrics.shape.error
            if kind == "radius-then-tree" and errors[kind] < 0.01 and step.metrics.conditions.in_p:
                break
    assert errors["radius"] > 0.3
    assert errors["radius-then-tree"] < 0.01
    assert step.metrics.conditions.in_p
