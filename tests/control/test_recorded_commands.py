"""Robots whose wheels obey another command than that of their law."""

import numpy as np

from skyherd.control import (
    GoalFollowers,
    GoalInboxes,
    LatencyCompensation,
    MarkerGains,
    NeighborMemory,
    Wheels,
)
from skyherd.control.avoidance.speed_bound import AvoidanceRule
from skyherd.messages import MotionGoals, Proximity, VelocityCommand

IDS, STEP_S = np.array([3, 8]), 0.1
WHEELS = Wheels(0.6, 3.0)
"""Wheels of the robots of the scenario crowd."""


def followers(*, memory):
    """Return robots with latency compensation, or with a memory of bodies."""
    gains = MarkerGains(k=0.5, k_omega=2.0, b_th=0.0, side_m=0.4)
    inboxes = GoalInboxes(IDS, np.array([0]), 2.0)
    if not memory:
        compensation = LatencyCompensation(2, 0.4, memory_s=3.0)
        return GoalFollowers(inboxes, gains, WHEELS, latency_compensation=compensation)
    rule = AvoidanceRule(
        side_m=0.4, wheels=WHEELS, nominal_age_s=0.1, superseded_age_s=0.1, step_s=STEP_S, lifetime_s=2.0
    )
    return GoalFollowers(inboxes, gains, WHEELS, neighbors=NeighborMemory(IDS, IDS, 2.0), avoidance=rule)


def goals(time_s):
    return MotionGoals(
        unit_id=0,
        time_s=time_s,
        ids=IDS,
        rho_px=[100.0, 60.0],
        bearings_rad=[0.3, -2.0],
        sides_px=[20.0, 20.0],
        neighbor_ids=np.zeros((2, 0), dtype=int),
        neighbor_distances_px=np.zeros((2, 0)),
    )


def test_goal_moves_by_the_recorded_command_and_not_by_the_law():
    team = followers(memory=False)
    team.inboxes.receive(goals(0.0), 0.0)
    driven = VelocityCommand(IDS, np.array([0.2, 0.0]), np.array([0.0, -1.0]))
    for tick in range(5):
        ordered = team.decide(tick * STEP_S, []).command
        team.record(driven, tick * STEP_S)
    team.decide(5 * STEP_S, [])
    rho_sides = team.present_inboxes(5 * STEP_S).rho_px[0] / 20.0
    assert np.abs(ordered.v_mps).min() > 0.3
    # Robot 3 drove 0.1 m = 0.25 sides ahead; robot 8 turned by -0.5 rad on the spot.
    np.testing.assert_allclose(rho_sides, [5 * np.exp(0.3j) - 0.25, 3 * np.exp(-1.5j)], atol=1e-12)


def test_bearings_turn_by_the_recorded_command():
    team = followers(memory=True)
    near = Proximity(
        unit_id=0,
        time_s=0.0,
        horizon_sides=8.0,
        ids=IDS,
        robot_ids=IDS,
        other_ids=IDS[::-1],
        distances_sides=[4.0, 4.0],
        bearings_rad=[1.0, 2.0],
        reaches_sides=[2.0, 2.0],
        shares=[0.5, 0.5],
    )
    team.inboxes.receive(goals(0.0), 0.0)
    team.neighbors.receive(near)
    for tick in range(5):
        ordered = team.decide(tick * STEP_S, []).command
        team.record(VelocityCommand(IDS, np.zeros(2), np.array([0.7, -0.4])), tick * STEP_S)
    assert np.abs(ordered.omega_radps).min() > 0.1
    pair = team.neighbors.fresh(5 * STEP_S)
    np.testing.assert_allclose(
        team.neighbors.bearings_rad(pair, 5 * STEP_S), [1.0 - 0.35, 2.0 + 0.2], atol=1e-12
    )
