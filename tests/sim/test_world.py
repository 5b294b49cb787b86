"""Ground truth: exact arcs, flight within limits, zoom, the network, frame rates."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skyherd.datasets import Mission, NetworkModel, make_mission
from skyherd.loop import run_steps
from skyherd.messages import FlightCommand, VelocityCommand
from skyherd.render import project
from skyherd.sim.network import Network
from skyherd.sim.physics import make_world
from skyherd.sim.world import World, move_unicycles

EXACT = 1e-12
"""Tolerance for paths of a few metres, m: closed forms differ only by rounding."""


def random_robots(seed: int, count: int = 50) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(-5, 5, (count, 2)),
        rng.uniform(-np.pi, np.pi, count),
        rng.uniform(-1, 1, count),
        rng.uniform(-3, 3, count),
    )


def same_angle(one: np.ndarray, other: np.ndarray, tolerance: float) -> None:
    np.testing.assert_allclose(np.exp(1j * one), np.exp(1j * other), rtol=0, atol=tolerance)


# --- unicycles ---


@pytest.mark.smoke
def test_arcs_are_circles() -> None:
    """x' = x + (v/w)(sin(th + w t) - sin th), y' = y - (v/w)(cos(th + w t) - cos th): w here above 0.01."""
    positions, headings, v, omega = random_robots(1)
    omega = np.where(np.abs(omega) < 0.01, 0.5, omega)
    for t in (0.1, 1.0, 7.3):
        moved, turned = move_unicycles(positions, headings, v, omega, t)
        end = headings + omega * t
        radius = v / omega
        expected = positions + radius[:, None] * np.column_stack(
            [np.sin(end) - np.sin(headings), np.cos(headings) - np.cos(end)]
        )
        np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-10)  # radii of 100 m lose two digits
        same_angle(turned, end, EXACT)


def test_arcs_solve_the_unicycles_equations() -> None:
    """The reference is a numerical integrator with a tolerance of 1e-12."""
    positions, headings, v, omega = random_robots(2, 8)
    moved, turned = move_unicycles(positions, headings, v, omega, 2.0)
    for i in range(8):

        def flow(_: float, state: np.ndarray, i: int = i) -> list[float]:
            return [v[i] * np.cos(state[2]), v[i] * np.sin(state[2]), omega[i]]

        end = solve_ivp(
            flow, (0, 2), [*positions[i], headings[i]], method="DOP853", rtol=1e-12, atol=1e-12
        ).y[:, -1]
        np.testing.assert_allclose(moved[i], end[:2], rtol=0, atol=1e-9)
        same_angle(turned[i], end[2], 1e-9)


def test_two_half_steps_are_one_step() -> None:
    positions, headings, v, omega = random_robots(3)
    whole = move_unicycles(positions, headings, v, omega, 0.8)
    half = move_unicycles(positions, headings, v, omega, 0.4)
    halves = move_unicycles(*half, v, omega, 0.4)
    np.testing.assert_allclose(halves[0], whole[0], rtol=0, atol=EXACT)
    same_angle(halves[1], whole[1], EXACT)


def test_there_and_back_again() -> None:
    positions, headings, v, omega = random_robots(4)
    back = move_unicycles(*move_unicycles(positions, headings, v, omega, 1.1), v, omega, -1.1)
    np.testing.assert_allclose(back[0], positions, rtol=0, atol=EXACT)
    same_angle(back[1], headings, EXACT)


@pytest.mark.parametrize("omega", [0.0, 1e-300, 1e-12, -1e-9, 1e-6])
def test_no_turn_is_a_straight_line(omega) -> None:
    """The arc leaves its tangent by v w t²/2; the test allows this and rounding."""
    moved, _ = move_unicycles(
        np.array([[1.0, 2.0]]), np.array([0.3]), np.array([0.8]), np.array([omega]), 5.0
    )
    straight = [1 + 4 * np.cos(0.3), 2 + 4 * np.sin(0.3)]
    np.testing.assert_allclose(moved[0], straight, rtol=0, atol=0.8 * abs(omega) * 25 / 2 + EXACT)


def test_a_full_circle_comes_home() -> None:
    moved, turned = move_unicycles(
        np.array([[1.0, 2.0]]), np.array([0.3]), np.array([0.8]), np.array([2 * np.pi]), 1
    )
    np.testing.assert_allclose(moved, [[1, 2]], rtol=0, atol=EXACT)
    same_angle(turned, np.array([0.3]), EXACT)


def test_a_curved_path_converges_at_the_order_of_its_commands() -> None:
    """Arcs are exact for constant commands; for v(t), w(t) held at each step's middle the order is two.

    A regression over step sizes recovers the order, so that no first-order error remains in the step.
    """

    def drive(steps: int) -> complex:
        dt = 4.0 / steps
        state = np.array([[0.0, 0.0]]), np.array([0.0])
        for n in range(steps):
            t = (n + 0.5) * dt
            state = move_unicycles(*state, np.array([1 + np.sin(t)]), np.array([np.cos(2 * t)]), dt)
        return complex(*state[0][0])

    counts = np.array([20, 40, 80, 160])
    errors = [abs(drive(int(count)) - drive(5120)) for count in counts]
    slope = np.polyfit(np.log(4.0 / counts), np.log(errors), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.1)


# --- aerial units ---


@pytest.fixture
def mission_of(scenario_tree) -> Any:
    """Return the triangle under one hovering unit, with the changes of a test."""

    def make(unit: dict[str, Any] | None = None, units: int = 1, **changes: Any) -> Mission:
        tree = scenario_tree("triangle")
        tree["perception"] = "ideal"
        base = {**tree["units"][0], "height_m": 14.0, "flight": {"kind": "hover"}, **(unit or {})}
        tree["units"] = [base] * units
        for key, value in changes.items():
            tree[key] = {**tree.get(key, {}), **value} if isinstance(value, dict) else value
        return make_mission(tree)

    return make


def hold(world: World) -> VelocityCommand:
    return VelocityCommand(world.ids, np.zeros(world.ids.size), np.zeros(world.ids.size))


def fly(world: World, lateral: tuple[float, float], climb: float, yaw_rate: float, seconds: float) -> None:
    world.fly(FlightCommand(0, np.array(lateral), climb, yaw_rate))
    for tick in range(round(seconds * 10)):
        world.advance(hold(world), tick / 10, 0.1)


@pytest.mark.parametrize("yaw_deg", [0.0, 35.0, -150.0])
@pytest.mark.parametrize(("axis", "lateral"), [(0, (0.5, 0.0)), (1, (0.0, 0.5))], ids=["+u", "+v"])
def test_flight_along_image_axis_moves_ground_backward(mission_of, yaw_deg, axis, lateral) -> None:
    """The image moves by f/h times the path, in pixels, and not across, to rounding."""
    world = make_world(mission_of({"yaw_deg": yaw_deg}))
    before = project(world.cameras[0], world.camera_pose(0), world.positions_m)
    fly(world, lateral, 0.0, 0.0, 2.0)
    moved = project(world.cameras[0], world.camera_pose(0), world.positions_m) - before
    focal_px = 400 / np.tan(np.radians(42.0))
    expected = np.zeros(2)
    expected[axis] = -focal_px / 14.0 * 0.5 * 2.0
    np.testing.assert_allclose(moved, np.tile(expected, (6, 1)), rtol=0, atol=1e-9)


def test_climbing_shrinks_the_image_and_yawing_turns_it(mission_of) -> None:
    """Counter-clockwise yaw seen from above turns the scene clockwise in the displayed image."""
    world = make_world(mission_of(autopilot={"max_climb_mps": 1.0}))
    center = np.array([407.0, 392.0])  # the principal point: the unit turns and climbs about it
    before = project(world.cameras[0], world.camera_pose(0), world.positions_m) - center
    fly(world, (0.0, 0.0), 0.7, 0.1, 2.0)
    after = project(world.cameras[0], world.camera_pose(0), world.positions_m) - center
    ratio = (after[:, 0] + 1j * after[:, 1]) / (before[:, 0] + 1j * before[:, 1])
    # Angles from +u to +v are clockwise seen from above, so that a clockwise turn of the scene is positive.
    np.testing.assert_allclose(ratio, 14.0 / 15.4 * np.exp(0.2j), rtol=0, atol=1e-12)


def test_the_autopilot_keeps_its_limits(mission_of) -> None:
    limits = {"min_height_m": 12.0, "max_height_m": 16.0, "max_speed_mps": 0.5, "max_climb_mps": 0.4}
    world = make_world(mission_of(autopilot=limits | {"max_yaw_rate_degps": 10.0}))
    start = world.fleet
    fly(world, (30.0, 40.0), -9.0, 9.0, 0.1)
    way = world.fleet.positions_m[0] - start.positions_m[0]
    assert np.linalg.norm(way) == pytest.approx(0.05, abs=EXACT), "speed is limited as a vector, not by axis"
    assert world.fleet.heights_m[0] == pytest.approx(14.0 - 0.04, abs=EXACT)
    assert world.fleet.yaws_rad[0] == pytest.approx(np.radians(1.0), abs=EXACT)
    fly(world, (0.0, 0.0), -9.0, 0.0, 20.0)
    assert world.fleet.heights_m[0] == 12.0
    fly(world, (0.0, 0.0), 9.0, 0.0, 20.0)
    assert world.fleet.heights_m[0] == 16.0


def test_the_direction_of_a_limited_flight_is_kept(mission_of) -> None:
    """(30, 40) in the image at yaw 0 is +x and -y on the ground."""
    world = make_world(mission_of(autopilot={"max_speed_mps": 0.5}))
    start = world.fleet.positions_m[0]
    fly(world, (30.0, 40.0), 0.0, 0.0, 1.0)
    np.testing.assert_allclose(world.fleet.positions_m[0] - start, [0.3, -0.4], rtol=0, atol=EXACT)


def test_a_unit_that_is_told_nothing_stays(mission_of) -> None:
    world = make_world(mission_of())
    start = world.fleet
    for tick in range(10):
        world.advance(hold(world), tick / 10, 0.1)
    np.testing.assert_array_equal(world.fleet.positions_m, start.positions_m)
    np.testing.assert_array_equal(world.fleet.heights_m, start.heights_m)


def test_zoom_is_linear_between_its_points_and_flat_outside(mission_of) -> None:
    world = make_world(mission_of({"zoom": [[1.0, 1.0], [3.0, 2.0], [4.0, 0.5]]}))
    seen = {0.0: world.camera_pose(0).zoom}
    for tick in range(60):
        world.advance(hold(world), tick / 10, 0.1)
        seen[round((tick + 1) / 10, 1)] = world.camera_pose(0).zoom
    expected = {0.0: 1.0, 1.0: 1.0, 2.0: 1.5, 3.0: 2.0, 3.5: 1.25, 4.0: 0.5, 6.0: 0.5}
    assert {t: seen[t] for t in expected} == pytest.approx(expected, abs=1e-9)


def test_zoom_scales_the_image_about_the_principal_point(mission_of) -> None:
    one, two = (make_world(mission_of({"zoom": [[0.0, z]]})) for z in (1.0, 2.0))
    center = np.array([407.0, 392.0])
    wide = project(one.cameras[0], one.camera_pose(0), one.positions_m) - center
    near = project(two.cameras[0], two.camera_pose(0), two.positions_m) - center
    np.testing.assert_allclose(near, 2 * wide, rtol=0, atol=1e-9)


def test_wheels_have_limits(mission_of) -> None:
    world = make_world(mission_of(robots={"max_speed_mps": 0.3, "max_turn_radps": 1.5}))
    asked = VelocityCommand(
        world.ids, np.array([-1, 1, 0.3, -0.1, 0, 0.2]), np.array([2, -2, 1.5, -0.1, 0, 1])
    )
    given = world.limit(asked)
    np.testing.assert_array_equal(given.v_mps, [-0.3, 0.3, 0.3, -0.1, 0, 0.2])
    np.testing.assert_array_equal(given.omega_radps, [1.5, -1.5, 1.5, -0.1, 0, 1])


# --- network ---


@pytest.mark.smoke
def test_messages_arrive_after_their_latency_and_once(make_goals, make_report) -> None:
    network = Network(NetworkModel(), np.random.default_rng(0), 2)
    network.send([make_goals(0, [1, 2], [1, 2])], make_report(0, [1, 2], [0, 1], [1, 2]), 0.25)
    assert network.deliver(0.2) == []
    assert network.reports == [{}, {}]
    (delivery,) = network.deliver(0.3)
    goals, received = delivery.message, delivery.received
    assert goals.ids.tolist() == [1, 2] and received.all()
    assert list(network.reports[1]) == [0] and network.reports[0] == {}, (
        "others hear a report, not its sender"
    )
    assert network.deliver(0.4) == []


@pytest.mark.parametrize("loss", [0.1, 0.5])
def test_losses_are_independent_and_of_the_stated_share(make_goals, make_report, loss) -> None:
    """4000 receptions by robots, 1000 by units: 5 standard deviations of a binomial."""
    network = Network(NetworkModel(message_loss=loss), np.random.default_rng(1), 2)
    heard, reports = [], 0
    for n in range(1000):
        network.send([make_goals(0, [0, 1, 2, 3], [1, 1, 1, 1])], make_report(0, [0], [0], [0]), n)
        network.reports[1].clear()
        heard += [delivery.received for delivery in network.deliver(n)]
        reports += len(network.reports[1])
    per_robot = np.array(heard).mean(axis=0)
    sd = np.sqrt(loss * (1 - loss) / 1000)
    np.testing.assert_allclose(per_robot, 1 - loss, rtol=0, atol=5 * sd)
    assert reports / 1000 == pytest.approx(1 - loss, abs=5 * sd)
    correlation = np.corrcoef(np.array(heard).T)[np.triu_indices(4, 1)]
    assert np.abs(correlation).max() < 5 / np.sqrt(1000)


def test_losses_come_from_the_generator(make_goals, make_report) -> None:
    def receptions(seed: int) -> list[list[bool]]:
        network = Network(NetworkModel(message_loss=0.4), np.random.default_rng(seed), 1)
        result = []
        for n in range(30):
            network.send([make_goals(0, [0, 1], [1, 1])], make_report(0, [0], [0], [0]), n)
            result += [delivery.received.tolist() for delivery in network.deliver(n)]
        return result

    assert receptions(3) == receptions(3)
    assert receptions(3) != receptions(4)


# --- time in the loop ---


def test_latency_delays_commands_by_itself(mission_of) -> None:
    """With 0.35 s and steps of 0.1 s robots stand still until 0.3 s and drive from 0.4 s on."""
    steps = list(run_steps(mission_of({"latency_s": 0.35}, duration_s=1.0)))
    moving = [step.time_s for step in steps if np.abs(step.command.v_mps).max() > 0]
    assert moving[0] == pytest.approx(0.4)
    assert len(moving) == 7


def test_a_robot_that_hears_nothing_stops_after_its_timeout(mission_of) -> None:
    """Images at 1 Hz, timeout 0.5 s: driving 0.0-0.5 s of every second, still 0.6-0.9 s."""
    steps = list(run_steps(mission_of({"frame_rate_hz": 1.0}, duration_s=3.0, robots={"timeout_s": 0.5})))
    moving = [bool(np.abs(step.command.v_mps).min() > 0) for step in steps]
    still = [not np.any([step.command.v_mps, step.command.omega_radps]) for step in steps]
    assert moving[:30] == ([True] * 6 + [False] * 4) * 3
    assert still[:30] == ([False] * 6 + [True] * 4) * 3


@pytest.mark.parametrize("rate", [1.0, 3.0, 4.0, 7.0, 10.0])
def test_each_unit_keeps_its_frame_rate(mission_of, rate) -> None:
    """n seconds have n · rate images, and one at 0; the interval is 1/rate, to within a step."""
    steps = list(run_steps(mission_of({"frame_rate_hz": rate}, duration_s=6.0)))
    shots = np.array([step.time_s for step in steps if 0 in step.frames])
    for second in range(1, 7):
        assert np.sum(shots <= second + 1e-9) - 1 == second * rate
    assert np.abs(np.diff(shots) - 1 / rate).max() < 0.1
    assert [
        frame.sight.detections.time_s for step in steps for frame in step.frames.values()
    ] == shots.tolist()


def test_lost_frames_are_of_the_stated_share(mission_of) -> None:
    """600 frames, 5 standard deviations."""
    steps = list(run_steps(mission_of(duration_s=59.9, network={"frame_loss": 0.3})))
    taken = sum(len(step.frames) for step in steps)
    assert taken / 600 == pytest.approx(0.7, abs=5 * np.sqrt(0.21 / 600))


def test_simulated_time_is_ticks_times_the_step(mission_of) -> None:
    steps = list(run_steps(mission_of(duration_s=2.0)))
    assert [step.time_s for step in steps] == [tick * 0.1 for tick in range(21)]
