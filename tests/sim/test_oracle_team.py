"""Robots that receive their positions from the world, with errors and losses."""

import numpy as np
import pytest

from skyherd.control import MarkerGains, Wheels
from skyherd.datasets import load_mission
from skyherd.loop import run_steps
from skyherd.sim.oracle_team import News, OracleTeam
from skyherd.sim.physics import make_world

STEP_S = 0.2


def team_of(law, *, noise_m=0.0, loss=0.0, lifetime_s=0.5):
    """Return robots that turn as fast as they drive, and their world."""
    world = make_world(load_mission("crowd"))
    news = News(noise_m, loss, lifetime_s, np.random.default_rng(3))
    gains = MarkerGains(k=0.6, k_omega=2.4, b_th=0.0, side_m=0.4)
    return OracleTeam(world, law, gains, Wheels(10.0, 10.0), news), world


def ahead(world):
    """Return a law with 0.5 m/s straight ahead for each robot."""
    return lambda places: 0.5 * np.exp(1j * world.headings_rad)


def test_robot_facing_desired_velocity_drives_at_that_speed() -> None:
    told = []
    team, world = team_of(lambda places: told.append(places) or 0.5 * np.exp(1j * world.headings_rad))
    orders = team.decide(0.0, [])
    np.testing.assert_allclose(orders.command.v_mps, 0.5, atol=1e-12)
    np.testing.assert_allclose(orders.command.omega_radps, 0.0, atol=1e-12)
    np.testing.assert_array_equal(told[0], world.positions_m @ np.array([1, 1j]))
    np.testing.assert_array_equal(orders.commanded_ids, world.ids)


def test_position_errors_are_normal_and_independent_per_step() -> None:
    told = []
    team, world = team_of(lambda places: told.append(places) or 0 * places, noise_m=0.05)
    for tick in range(400):
        team.decide(tick * STEP_S, [])
    errors = np.array(told) - world.positions_m @ np.array([1, 1j])
    parts = np.stack([errors.real, errors.imag])
    assert np.std(parts) == pytest.approx(0.05, rel=0.03)  # of 12800 draws: 0.6 %
    assert abs(parts.mean()) < 5 * 0.05 / np.sqrt(parts.size)
    neighbours = [np.mean(parts[:, 1:] * parts[:, :-1]), np.mean(parts[0] * parts[1])]
    assert np.abs(neighbours).max() < 6 * 0.05**2 / np.sqrt(parts.size / 2)


def test_a_robot_without_news_drives_on_as_it_did_and_then_stops() -> None:
    """A robot receives its position with a probability of 30 %; it stops after 0.5 s without one."""
    speed = {"now": 0.1}
    team, world = team_of(lambda places: speed["now"] * np.exp(1j * world.headings_rad), loss=0.7)
    last_s, last_mps = np.full(16, -np.inf), np.zeros(16)
    shares = []
    for tick in range(300):
        speed["now"] = 0.1 + 0.001 * tick
        orders = team.decide(tick * STEP_S, [])
        told = np.isclose(orders.command.v_mps, speed["now"], atol=1e-9)
        last_s[told], last_mps[told] = tick * STEP_S, speed["now"]
        old = tick * STEP_S - last_s > 0.5 + 1e-6
        np.testing.assert_allclose(orders.command.v_mps, np.where(old, 0.0, last_mps), atol=1e-9)
        np.testing.assert_array_equal(orders.commanded_ids, world.ids[~old])
        shares.append(told.mean())
    assert np.mean(shares) == pytest.approx(0.3, abs=0.03)
    assert (np.array(shares) < 1).all()


def test_robots_without_any_position_stand_still() -> None:
    team, _ = team_of(lambda places: 1.0 + 0 * places, loss=1.0)
    orders = team.decide(0.0, [])
    assert not orders.command.v_mps.any() and not orders.command.omega_radps.any()
    assert orders.commanded_ids.size == 0


def crowded_gap_m(*settings: str) -> tuple[float, float]:
    """Return the smallest gap between bodies, m, and the final shape error of a law among crowded robots."""
    mission = load_mission(
        "crowd",
        [
            "control.method=complex-laplacian",
            "control.k=4.8",
            "duration_s=50",
            "perception=ideal",
            "units.*.frame_rate_hz=0.02",
            "step_s=0.2",
            "roles.exchange=false",
            "size.min_spacing_sides=0",
            *settings,
        ],
    )
    gaps_m = []
    for step in run_steps(mission):
        gaps_m.append(mission.bodies.gaps_m(step.positions_m).min())
    return min(gaps_m), step.metrics.shape.error


def test_avoidance_of_a_law_keeps_bodies_apart() -> None:
    """Without it the same start has contacts: fixed roles drive robots through each other."""
    assert crowded_gap_m("avoidance.on=false")[0] < 0
    for detour in ("around", "nearest"):
        assert crowded_gap_m("avoidance.on=true", f"avoidance.detour={detour}")[0] >= 0


def test_avoidance_of_a_law_keeps_bodies_and_obstacles_apart() -> None:
    obstacles = "obstacles=[{ id = 40, position_m = [0.0, 0.6] }, { id = 41, position_m = [-0.55, -0.35] }]"
    scatter = "robots.scatter={ scale_m = 2.6, jitter_m = 1.2, spacing_m = 0.9, rotation_deg = 20.0 }"
    task = (obstacles, scatter, "duration_s=20")
    assert crowded_gap_m("avoidance.on=false", *task)[0] < 0
    assert crowded_gap_m("avoidance.on=true", "roles.assigned=similar", *task)[0] >= 0


def test_avoidance_without_bodies_nearby_changes_no_command() -> None:
    """Points that start far apart never come within the horizon of 8 sides less their reach."""
    far = (
        "robots.scatter={ scale_m = 40.0, jitter_m = 1.0 }",
        "robots.body_radius_sides=0.0",
        "duration_s=4",
    )
    near_law = [crowded_gap_m(*far, f"avoidance.on={on}")[1] for on in ("true", "false")]
    assert near_law[0] == near_law[1]


def test_avoidance_under_losses_keeps_bodies_apart() -> None:
    assert crowded_gap_m("avoidance.on=true", "network.message_loss=0.5", "duration_s=30")[0] >= 0
