"""Effects of the drive on robots: each effect, and no change while it is off."""

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skyherd.datasets import make_mission
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.errors import InputError
from skyherd.geometry import wrap_angle
from skyherd.messages import VelocityCommand
from skyherd.sim.drive import SLIP_TIME_S, Drive, DriveParameters, body_rates, wheel_speeds
from skyherd.sim.physics import make_drive, make_world
from skyherd.sim.world import move_bodies, move_unicycles

STEP_S = 0.1
ROUNDING = 1e-12
"""Tolerance for speeds of a few m/s and rad/s: the rounding of a few additions."""


def commands(seed: int, steps: int, count: int) -> list[VelocityCommand]:
    rng = np.random.default_rng(seed)
    ids = np.arange(count)
    return [VelocityCommand(ids, rng.uniform(-1, 1, count), rng.uniform(-3, 3, count)) for _ in range(steps)]


def drive_of(parameters: DriveParameters, count: int, seed: int) -> Drive:
    gain_rng, slip_rng = (generator(seed, stream) for stream in (RunStream.WHEEL_GAINS, RunStream.WHEEL_SLIP))
    return Drive(parameters, count, step_s=STEP_S, gain_rng=gain_rng, slip_rng=slip_rng)


def drive_through(asked: list[VelocityCommand], seed: int = 7, **parts: Any) -> np.ndarray:
    """Return v and omega of every step, (T, 2, N)."""
    drive = drive_of(DriveParameters(**parts), len(asked[0].ids), seed)
    return np.array([drive.step(command) for command in asked])


def plain(asked: list[VelocityCommand]) -> np.ndarray:
    return np.array([[command.v_mps, command.omega_radps] for command in asked])


def test_with_all_parts_off_a_command_is_what_happens_to_the_bit() -> None:
    asked = commands(1, 20, 30)
    np.testing.assert_array_equal(drive_through(asked), plain(asked))


def test_world_without_drive_effects_moves_as_exact_unicycles(scenario_tree) -> None:
    mission = make_mission(scenario_tree("triangle"))
    world, state = make_world(mission), (mission.positions_m, mission.headings_rad)
    for tick, command in enumerate(commands(2, 50, mission.ids.size)):
        world.advance(command, tick * STEP_S, STEP_S)
        state = move_unicycles(*state, command.v_mps, command.omega_radps, STEP_S)
    np.testing.assert_array_equal(world.positions_m, state[0])
    np.testing.assert_array_equal(world.headings_rad, state[1])


def test_wheels_and_body_are_one_motion_told_twice() -> None:
    v, omega = plain(commands(3, 1, 50))[0]
    np.testing.assert_allclose(body_rates(wheel_speeds(v, omega, 0.3), 0.3), (v, omega), atol=ROUNDING)


@pytest.mark.parametrize("others", [{}, {"gain_error": 0.2, "wheel_step_mps": 0.05, "delay_s": 0.3}])
def test_acceleration_is_never_exceeded_and_all_of_it_is_used(others: dict[str, float]) -> None:
    """This also holds after other wheel effects; commands that jump by up to 2 m/s reach the limit."""
    limits = np.array([0.8, 2.5])
    rates = drive_through(
        commands(4, 200, 40), max_accel_mps2=limits[0], max_turn_accel_radps2=limits[1], **others
    )
    changes = np.abs(np.diff(rates, axis=0, prepend=np.zeros((1, 2, 40)))) / STEP_S
    assert (changes.max(axis=(0, 2)) <= limits + 1e-9).all()
    np.testing.assert_allclose(changes.max(axis=(0, 2)), limits, rtol=0, atol=1e-9)


def test_a_robot_brakes_to_a_full_stop_in_v_over_a() -> None:
    ids, ones = np.arange(2), np.ones(2)
    asked = [VelocityCommand(ids, ones, ones)] * 10 + [VelocityCommand(ids, 0 * ones, 0 * ones)] * 10
    v = drive_through(asked, max_accel_mps2=2.0)[:, 0, 0]
    np.testing.assert_allclose(v[:5], [0.2, 0.4, 0.6, 0.8, 1.0], atol=ROUNDING)
    np.testing.assert_allclose(v[10:14], [0.8, 0.6, 0.4, 0.2], atol=ROUNDING)
    assert abs(v[14]) < ROUNDING and (v[15:] == 0).all()


def test_wheel_speeds_are_rounded_to_multiples_of_the_step() -> None:
    asked = commands(5, 50, 40)
    rates = drive_through(asked, wheel_step_mps=0.07, track_m=0.25)
    wheels, wanted = (
        np.array([wheel_speeds(v, omega, 0.25) for v, omega in every]) for every in (rates, plain(asked))
    )
    assert np.abs(wheels / 0.07 - np.rint(wheels / 0.07)).max() < 1e-9
    worst = np.abs(wheels - wanted).max()
    assert 0.034 < worst <= 0.035 + ROUNDING


def test_only_slow_wheels_are_in_the_dead_zone() -> None:
    asked = commands(6, 50, 40)
    wheels, wanted = (
        np.array([wheel_speeds(v, omega, 0.2) for v, omega in every])
        for every in (drive_through(asked, dead_zone_mps=0.3), plain(asked))
    )
    slow = np.abs(wanted) < 0.3
    assert 0.1 < slow.mean() < 0.9
    assert np.abs(wheels[slow]).max() < ROUNDING
    np.testing.assert_allclose(wheels[~slow], wanted[~slow], rtol=0, atol=ROUNDING)


@pytest.mark.parametrize(("delay_s", "steps"), [(0.1, 1), (0.3, 3), (0.25, 3), (1e-3, 1)])
def test_a_delay_is_an_exact_shift(delay_s: float, steps: int) -> None:
    asked = commands(8, 30, 5)
    rates = drive_through(asked, delay_s=delay_s)
    assert (rates[:steps] == 0).all()
    np.testing.assert_array_equal(rates[steps:], plain(asked)[:-steps])


def test_gains_are_drawn_once_within_their_bounds_from_the_seed() -> None:
    """4000 uniform draws within +-0.2: mean and variance to 5 of their standard deviations.

    The variance of a uniform variable's square is `x⁴ (1/5 - 1/9)`, where x is its bound.
    """
    parameters = DriveParameters(gain_error=0.2)
    errors = drive_of(parameters, 2000, 1).gains.ravel() - 1
    assert np.abs(errors).max() <= 0.2
    assert abs(errors.mean()) < 5 * 0.2 / np.sqrt(3 * 4000)
    assert abs((errors**2).mean() - 0.2**2 / 3) < 5 * 0.2**2 * np.sqrt((1 / 5 - 1 / 9) / 4000)
    np.testing.assert_array_equal(drive_of(parameters, 2000, 1).gains.ravel() - 1, errors)
    assert (drive_of(parameters, 2000, 2).gains.ravel() - 1 != errors).all()
    asked = commands(9, 10, 30)
    gains = drive_of(parameters, 30, 7).gains
    for rates, (v, omega) in zip(drive_through(asked, gain_error=0.2), plain(asked), strict=True):
        expected = body_rates(gains * wheel_speeds(v, omega, 0.2), 0.2)
        np.testing.assert_allclose(rates, expected, rtol=0, atol=ROUNDING)


def test_slip_has_the_stated_spread_and_memory() -> None:
    """N = 20 000 independent normal variables at any instant, from the first step on.

    The standard deviations of N normal variables are `sqrt(2 / N)` for variances, `1 / sqrt(N)` for means and
    `(1 - rho²) / sqrt(N)` for correlations. The test allows 5 of each.
    """
    count, sd = 10_000, 0.1
    ids = np.arange(count)
    asked = [VelocityCommand(ids, np.full(count, 0.5), np.full(count, -2.0))] * 8
    slips = drive_through(asked, slip=sd) / plain(asked)[0] - 1
    n = 2 * count
    for slip in slips:
        assert abs(slip.mean()) < 5 * sd / np.sqrt(n)
        assert abs(slip.var() / sd**2 - 1) < 5 * np.sqrt(2 / n)
        assert abs(np.corrcoef(slip[0], slip[1])[0, 1]) < 5 / np.sqrt(count), "v and omega are independent"
    for lag in (1, 3, 7):
        rho = np.exp(-lag * STEP_S / SLIP_TIME_S)
        found = np.corrcoef(slips[0].ravel(), slips[lag].ravel())[0, 1]
        assert abs(found - rho) < 5 * (1 - rho**2) / np.sqrt(n)


def test_slip_and_gains_are_streams_of_their_own() -> None:
    """Gains are the same with and without slip, and a repeated run is the same."""
    asked = commands(10, 10, 20)
    both = drive_through(asked, slip=0.2, gain_error=0.1)
    np.testing.assert_array_equal(both, drive_through(asked, slip=0.2, gain_error=0.1))
    gains = drive_through(asked, gain_error=0.1)
    slip = drive_through(asked, slip=0.2) / plain(asked)
    np.testing.assert_allclose(both, gains * slip, rtol=1e-12)


@pytest.mark.parametrize("offset_m", [0.15, -0.3])
def test_offset_body_motion_matches_integrated_equations(offset_m: float) -> None:
    """`c' = v e(theta) + offset omega e(theta + pi/2)`; the reference integrator has a tolerance of 1e-12."""
    rng = np.random.default_rng(11)
    positions, headings = rng.uniform(-5, 5, (8, 2)), rng.uniform(-np.pi, np.pi, 8)
    v, omega = rng.uniform(-1, 1, 8), np.append(rng.uniform(-3, 3, 7), 0.0)
    moved, turned = move_bodies(positions, headings, v, omega, step_s=2.0, axis_offset_m=offset_m)
    for i in range(8):

        def flow(_: float, state: np.ndarray, i: int = i) -> list[float]:
            across = offset_m * omega[i]
            sine, cosine = np.sin(state[2]), np.cos(state[2])
            return [v[i] * cosine - across * sine, v[i] * sine + across * cosine, omega[i]]

        start = [*positions[i], headings[i]]
        end = solve_ivp(flow, (0, 2), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(moved[i], end[:2], rtol=0, atol=1e-9)
        assert abs(wrap_angle(turned[i] - end[2])) < 1e-9


def test_the_worlds_motion_is_that_of_the_bodies(scenario_tree) -> None:
    """The velocities for motion blur equal the motion of the next 1e-6 s at the same rates."""
    tree = scenario_tree("triangle")
    tree["robots"]["drive"] = {"axis_offset_m": 0.2, "gain_error": 0.1}
    mission = make_mission(tree)
    world, (command,) = make_world(mission), commands(12, 1, mission.ids.size)
    world.advance(command, 0.0, STEP_S)
    motion, before, headings = world.motion(0), world.positions_m, world.headings_rad
    world.advance(command, STEP_S, 1e-6)
    assert motion.robots_mps is not None and motion.robots_radps is not None
    np.testing.assert_allclose((world.positions_m - before) / 1e-6, motion.robots_mps, rtol=0, atol=1e-5)
    turned = wrap_angle(world.headings_rad - headings) / 1e-6
    np.testing.assert_allclose(turned, motion.robots_radps, rtol=0, atol=1e-5)


def test_a_scenario_names_parts_by_single_keys(scenario_tree) -> None:
    tree = scenario_tree("triangle")
    tree["robots"]["drive"] = {"slip": 0.1, "delay_s": 0.2, "max_accel_mps2": 0.5, "wheel_step_mps": 0.01}
    assert make_mission(tree).scenario.robots.drive.slip == 0.1
    for key, value in {
        "slip": 1.0,
        "max_accel_mps2": 0.0,
        "delay_s": -1.0,
        "track_m": 0.0,
        "skid": 1,
    }.items():
        tree["robots"]["drive"] = {key: value}
        with pytest.raises(InputError, match=rf"robots\.drive\.{key}"):
            make_mission(tree)


def test_every_key_of_a_scenario_reaches_the_drive(scenario_tree) -> None:
    """Keys have the same names, each with its own value; omitted keys have the defaults of the class."""
    keys = {
        name: 0.01 * (number + 1)
        for number, name in enumerate(field.name for field in fields(DriveParameters))
    }
    limits = {name: keys[name] for name in ("max_speed_mps", "max_turn_radps")}
    tree = scenario_tree("triangle")
    parts = {name: value for name, value in keys.items() if name not in limits}
    tree["robots"] |= limits | {"drive": parts}
    assert make_drive(make_mission(tree).scenario, 2).parameters == DriveParameters(**keys)
    tree["robots"]["drive"] = {}
    assert make_drive(make_mission(tree).scenario, 2).parameters == DriveParameters(**limits)
