"""Latency compensation: a late goal minus the robot's motion since its image equals a present goal."""

import numpy as np
import pytest

from skyherd.control import GoalInboxes, LatencyCompensation
from skyherd.datasets import load_mission
from skyherd.errors import InputError
from skyherd.geometry import to_complex, to_points
from skyherd.loop import run_steps
from skyherd.messages import VelocityCommand
from skyherd.sim.world import move_bodies

SIDE_M, STEP_S, ROBOTS = 0.3, 0.1, 5


def goals_at(make_goals, axles, headings, targets, sides, offset_m, time_s):
    """Return goals of one unit for fixed ground targets, as from an image at this time."""
    markers = axles + offset_m * np.exp(1j * headings)
    rho_m = (targets - markers) * np.exp(-1j * headings)
    return make_goals(0, range(ROBOTS), rho_m * sides / SIDE_M, sides=sides, time_s=time_s)


@pytest.mark.parametrize("offset_m", [0.0, 0.12])
@pytest.mark.parametrize("delay_steps", [0, 3])
@pytest.mark.parametrize(("age_steps", "lead_s"), [(0, 0.0), (1, 0.0), (7, 0.0), (7, 4.0)])
def test_late_goal_becomes_present_goal(make_goals, age_steps, lead_s, delay_steps, offset_m) -> None:
    """The drives are the simulator's exact arcs, and obey each command `delay_steps` late.

    The stamping clock may be ahead.
    """
    rng = np.random.default_rng(11)
    steps = 25
    commands = rng.normal(0, 1, (steps, 2, ROBOTS))
    commands[::5, 1] = 0.0
    motion = LatencyCompensation(
        ROBOTS, SIDE_M, axis_offset_m=offset_m, delay_s=delay_steps * STEP_S, memory_s=2 * steps * STEP_S
    )
    axles, headings = to_complex(rng.normal(0, 3, (ROBOTS, 2))), rng.uniform(-3, 3, ROBOTS)
    markers = to_points(axles + offset_m * np.exp(1j * headings))
    history = [(to_complex(markers), headings)]
    for step in range(steps):
        motion.record(VelocityCommand(range(ROBOTS), *commands[step]), step * STEP_S)
        obeyed = commands[step - delay_steps] if step >= delay_steps else np.zeros((2, ROBOTS))
        markers, headings = move_bodies(markers, headings, *obeyed, step_s=STEP_S, axis_offset_m=offset_m)
        history.append((to_complex(markers), headings))
    # Commands that were given are still to be obeyed: the robot's present goal is from where they lead.
    future, turned = markers, headings
    for late in range(delay_steps):
        future, turned = move_bodies(
            future, turned, *commands[steps - delay_steps + late], step_s=STEP_S, axis_offset_m=offset_m
        )
    targets, sides = to_complex(rng.normal(0, 3, (ROBOTS, 2))), rng.uniform(10, 40, ROBOTS)
    then, then_rad = history[steps - age_steps]
    inboxes = GoalInboxes(np.arange(ROBOTS), np.arange(1), 10.0)
    old_axles = then - offset_m * np.exp(1j * then_rad)
    imaged_s = (steps - age_steps) * STEP_S
    inboxes.receive(
        goals_at(make_goals, old_axles, then_rad, targets, sides, offset_m, imaged_s + lead_s), steps * STEP_S
    )
    before = inboxes.rho_px.copy()
    found = motion.compensate(inboxes, steps * STEP_S, np.full(ROBOTS, lead_s)).rho_px[0]
    wanted = (targets - to_complex(future)) * np.exp(-1j * turned) * sides / SIDE_M
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    np.testing.assert_array_equal(inboxes.rho_px, before)


def test_memory_is_bounded_and_clips_goal_age(make_goals) -> None:
    motion = LatencyCompensation(ROBOTS, SIDE_M, memory_s=0.5)
    drive = VelocityCommand(range(ROBOTS), np.ones(ROBOTS), np.zeros(ROBOTS))
    for step in range(1000):
        motion.record(drive, step * STEP_S)
    assert len(motion._knots) < 10
    inboxes = GoalInboxes(np.arange(ROBOTS), np.arange(1), 1e9)
    inboxes.receive(make_goals(0, range(ROBOTS), np.full(ROBOTS, 100 + 0j), time_s=0.0), 0.0)
    moved_m = (100 - motion.compensate(inboxes, 100.0).rho_px[0].real) * SIDE_M / 20
    assert (moved_m >= 0.5).all() and (moved_m <= 0.5 + 2 * STEP_S).all()


def test_static_robot_keeps_goals(make_goals) -> None:
    inboxes = GoalInboxes(np.arange(ROBOTS), np.arange(2), 1.0)
    inboxes.receive(make_goals(1, range(ROBOTS), np.arange(ROBOTS) + 2j), 0.0)
    current = LatencyCompensation(ROBOTS, SIDE_M, memory_s=1.0).compensate(inboxes, 0.4)
    np.testing.assert_array_equal(current.rho_px, inboxes.rho_px)


@pytest.mark.parametrize("wrong", [{"side_m": 0.0}, {"memory_s": np.nan}, {"delay_s": -1.0}])
def test_latency_compensation_rejects_invalid_numbers(wrong) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        LatencyCompensation(**({"count": 2, "side_m": 1.0, "memory_s": 1.0} | wrong))


def shape_error_at_end(gain: float, compensate: bool) -> float:
    settings = [
        "perception=ideal",
        "control.rectify=false",
        "duration_s=25",
        "units.*.latency_s=0.3",
        f"control.k={gain}",
        f"control.k_omega={4 * gain}",
        "robots.max_speed_mps=100",
        "robots.max_turn_radps=100",
        f"control.latency_compensation={str(compensate).lower()}",
    ]
    return [step.metrics.shape.error for step in run_steps(load_mission("triangle", settings))][-1]


def test_latency_compensation_allows_higher_gain() -> None:
    """0.3 s of latency and k_omega = 16 /s, three times the limit π/2 of a delayed integrator."""
    assert shape_error_at_end(4.0, True) < 0.005
    assert shape_error_at_end(4.0, False) > 0.05


def test_headings_follow_commands_until_they_expire() -> None:
    """Irregular commands of two robots, held for 0.5 s at most, against sums by hand."""
    motion = LatencyCompensation(2, SIDE_M, memory_s=10.0, hold_s=0.5)
    for time_s, omega_radps in ((1.0, [1.0, -2.0]), (1.25, [0.5, 0.0]), (3.0, [0.0, 1.0])):
        motion.record(VelocityCommand([0, 1], [0.3, 0.3], omega_radps), time_s)
    times_s = np.array([0.0, 1.125, 1.5, 1.75, 2.5, 3.25, 9.0, 9.0])
    robots = np.array([0, 1, 0, 0, 0, 1, 0, 1])
    expected_rad = [0.0, -0.25, 0.375, 0.5, 0.5, -0.25, 0.5, 0.0]
    np.testing.assert_allclose(motion.headings_rad(times_s, robots), expected_rad, atol=1e-12)


@pytest.mark.parametrize("offset_m", [0.0, 0.12])
def test_marker_poses_are_those_that_a_camera_sees(offset_m) -> None:
    """The simulator's arcs, with a delay of three steps; half-way between two commands too."""
    rng, delay_steps = np.random.default_rng(12), 3
    commands = rng.normal(0, 1, (20, 2, ROBOTS))
    motion = LatencyCompensation(
        ROBOTS, SIDE_M, axis_offset_m=offset_m, delay_s=delay_steps * STEP_S, memory_s=100.0
    )
    headings = np.zeros(ROBOTS)
    markers = to_points(np.full(ROBOTS, offset_m, dtype=complex))
    seen, times_s = [], []
    for step, command in enumerate(commands):
        motion.record(VelocityCommand(range(ROBOTS), *command), step * STEP_S)
        obeyed = commands[step - delay_steps] if step >= delay_steps else np.zeros((2, ROBOTS))
        for part in range(2):
            seen.append((to_complex(markers), headings))
            times_s.append((step + part / 2) * STEP_S)
            markers, headings = move_bodies(
                markers, headings, *obeyed, step_s=STEP_S / 2, axis_offset_m=offset_m
            )
    places_m, headings_rad = motion.marker_poses(np.array(times_s))
    np.testing.assert_allclose(places_m, [place for place, _ in seen], atol=1e-12)
    np.testing.assert_allclose(headings_rad, [heading for _, heading in seen], atol=1e-12)
