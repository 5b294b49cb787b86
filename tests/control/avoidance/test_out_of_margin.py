"""Robots with a body within their margin drive out of it, for any goals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyherd.control import AvoidanceRule, BodyRule, MarkerGains, NeighborMemory, Wheels
from skyherd.control.avoidance import speed_bound
from skyherd.control.avoidance.detour import out_of_margin
from skyherd.control.avoidance.proximity import proximity
from skyherd.control.avoidance.speed_bound import avoiding_law
from skyherd.geometry import to_complex, to_points, wrap_angle
from skyherd.sim.world import move_bodies

SIDE_M, STEP_S = 0.4, 0.2
WHEELS = Wheels(0.6, 3.0)
RULE = AvoidanceRule(SIDE_M, WHEELS, nominal_age_s=0.2, superseded_age_s=0.2, step_s=STEP_S, lag_s=0.4)
BODIES = BodyRule(radius_sides=1.0, margin_sides=0.2)
GAINS = MarkerGains(0.4, 2.0, 0.0, SIDE_M)


def nothing(preferred, *, rows, bearings_rad, spreads_rad):
    """Return no escape velocities, as a replacement of `out_of_margin`."""
    return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=complex)


def drive(make_detections, seed: int, steps: int = 150) -> tuple[np.ndarray, float]:
    """Return the final distances (2,) of two robots from their goals, m, and their minimum gap, m.

    They start half a margin apart, with any headings. Each has a goal 3 m away, at most 70 degrees off the
    direction straight away from the other one.
    """
    rng = np.random.default_rng(seed)
    positions = np.array([0.0, 2.1 * SIDE_M]) + 0j
    headings, ids = rng.uniform(-np.pi, np.pi, 2), np.arange(2)
    goals = positions + 3 * np.array([-1, 1]) * np.exp(1j * np.radians(rng.uniform(-70, 70, 2)))
    memory, least = NeighborMemory(ids, ids, RULE.lifetime_s), np.inf
    for step in range(steps):
        now_s = step * STEP_S
        points = 100 * positions.conj() + (400 + 400j)
        seen = make_detections(ids, points, headings=-headings, sides=np.full(2, 100 * SIDE_M), time_s=now_s)
        memory.receive(proximity(seen, ids, BODIES))
        rho = (goals - positions) * np.exp(-1j * headings) / SIDE_M
        v, omega = avoiding_law(rho, GAINS, memory=memory, rule=RULE, time_s=now_s)
        memory.record_rotation(omega, now_s, STEP_S)
        moved, headings = move_bodies(
            to_points(positions), headings, v, omega, step_s=STEP_S, axis_offset_m=0.0
        )
        positions = to_complex(moved)
        least = min(least, abs(positions[1] - positions[0]) - 2 * SIDE_M)
    return np.abs(goals - positions), least


@pytest.mark.parametrize("seed", range(8))
def test_robots_within_margin_separate_and_reach_goals(make_detections, seed) -> None:
    """They come no closer than at the start, since the bound is applied last."""
    left_m, min_m = drive(make_detections, seed)
    assert left_m.max() < 0.05 and min_m > 0.1 * SIDE_M - 1e-9


def test_robots_within_margin_without_rule_deadlock(make_detections, monkeypatch) -> None:
    monkeypatch.setattr(speed_bound, "out_of_margin", nothing)
    assert any(drive(make_detections, seed)[0].max() > 2.5 for seed in range(8))


@given(seed=st.integers(0, 2**31))
def test_escape_direction_is_nearest_away_from_all_bodies(seed) -> None:
    """Brute force over 36 directions. Robots that need none, or have none, are unchanged."""
    rng = np.random.default_rng(seed)
    rows = np.sort(rng.integers(0, 6, 9))
    bearings, spreads = rng.uniform(-np.pi, np.pi, 9), rng.uniform(0, 0.8, 9)
    preferred = rng.uniform(0.1, 0.6, 6) * np.exp(1j * rng.uniform(-np.pi, np.pi, 6))
    leaving, velocities = out_of_margin(preferred, rows=rows, bearings_rad=bearings, spreads_rad=spreads)
    thetas = np.linspace(-np.pi, np.pi, 36, endpoint=False)

    def away(robot: int, angle: float) -> bool:
        mine = rows == robot
        return bool((np.abs(wrap_angle(angle - bearings[mine])) >= np.pi / 2 + spreads[mine]).all())

    for robot in np.unique(rows):
        along = float(np.angle(preferred[robot]))
        ways = [theta for theta in thetas if away(robot, along + theta)]
        assert (robot in leaving) == (bool(ways) and not away(robot, along))
        if robot in leaving:
            taken = velocities[leaving.tolist().index(robot)]
            assert abs(taken) == pytest.approx(abs(preferred[robot]))
            assert away(robot, float(np.angle(taken)) + 1e-9) or away(robot, float(np.angle(taken)) - 1e-9)
            off = abs(float(wrap_angle(np.angle(taken) - along)))
            assert off <= min(abs(theta) for theta in ways) + np.radians(10) + 1e-9
