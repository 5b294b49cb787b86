"""Equations 2-3 and 6-8 against the paper's literal formulas, in its own coordinates."""

import numpy as np
import pytest

from skyherd.control import (
    GoalInboxes,
    MarkerGains,
    PixelGains,
    Template,
    Wheels,
    motion_goals,
    robot_commands,
)
from skyherd.control.robots.unicycle import finite_command, unicycle_law, wheel_law
from skyherd.geometry import wrap_angle

ROUNDING = 1e-12
"""Angles of order 1 through two transcendental functions: 1e-15, with a margin."""


def in_half_open(angle: float) -> float:
    """Return the angle wrapped to the paper's interval [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def paper_alpha(rho: np.ndarray, y: np.ndarray) -> float:
    """Return equation 3: `atan2(-[(rho; 0) x (y; 0)]_z, -rho^T y)`, in axes with z up, towards the camera."""
    rho_hat = rho / np.linalg.norm(rho)
    cross_z = np.cross([*rho_hat, 0.0], [*y, 0.0])[2]
    return in_half_open(np.arctan2(-cross_z, -rho_hat @ y))


def paper_law(rho: float, alpha: float, k: float, k_omega: float) -> tuple[float, float]:
    """Return the speeds of equations 7-8."""
    alpha_d = 0.0 if abs(alpha) <= np.pi / 2 else np.pi
    return -k * np.sign(np.cos(alpha)) * rho, k_omega * in_half_open(alpha_d - alpha)


def one_inbox(rho: np.ndarray) -> GoalInboxes:
    """Return inboxes of robots with vectors `rho` in their own frames from one unit; sides are 20 px."""
    inboxes = GoalInboxes(np.arange(rho.size), np.array([0]), 1.0)
    inboxes.rho_px[0] = rho
    inboxes.sides_px[0] = 20.0
    inboxes.received_s[0] = 0.0
    return inboxes


def test_bearing_equals_angle_of_paper(make_detections) -> None:
    """alpha = pi - bearing, with the paper's cross product; image v is down, so z up needs (u, -v)."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        points = 400 + 100 * (rng.standard_normal(6) + 1j * rng.standard_normal(6))
        headings = rng.uniform(-np.pi, np.pi, 6)
        template = Template(np.arange(6), rng.standard_normal(6) + 1j * rng.standard_normal(6))
        seen = make_detections(range(6), points, headings=headings)
        goals = motion_goals(seen, seen.ids, template, shared_ids=np.array([], dtype=int), nearest=2)
        t = template.points_px - template.points_px.mean()
        desired = points.mean() + np.vdot(t, points) / np.vdot(t, t) * t
        for robot in range(6):
            rho = desired[robot] - points[robot]
            assert goals.rho_px[robot] == pytest.approx(abs(rho), abs=1e-9)
            y = np.array([np.cos(headings[robot]), -np.sin(headings[robot])])
            alpha = paper_alpha(np.array([rho.real, -rho.imag]), y)
            difference = np.pi - goals.bearings_rad[robot] - alpha
            assert np.exp(1j * difference) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize(
    ("error_px", "drives_forwards"), [(-40 + 30j, True), (40 + 30j, False)], ids=["ahead", "behind"]
)
def test_goal_on_left_gives_positive_bearing_and_turn(make_detections, error_px, drives_forwards) -> None:
    """The only flip of sense. Seen from above, robot 0 faces image right (+u); its left is image up (-v).

    Robot 0 is 30 px below its desired point, and 40 px behind it or beyond it. The goal is well off the
    bearing of pi/2, at which the law changes from forwards to backwards, so that rounding has no effect.
    """
    template = Template(np.arange(3), np.array([-1 - 1j, 1 + 0j, -1 + 1j]))
    points = 400 + 400j + 100 * template.points_px + np.array([error_px, 0, 0])
    seen = make_detections(range(3), points, headings=[0, 0, 0])
    goals = motion_goals(seen, seen.ids, template, shared_ids=np.array([], dtype=int), nearest=1)
    bearing = goals.bearings_rad[0]
    assert 0 < bearing < np.pi
    assert abs(bearing - np.pi / 2) > 0.1
    inboxes = GoalInboxes(np.arange(3), np.array([0]), 1.0)
    inboxes.receive(goals, 0.0)
    for gains in (PixelGains(0.01, 1.0, 0.0), MarkerGains(0.1, 1.0, 0.0, 0.5)):
        command = robot_commands(inboxes, gains, 0.0)
        assert (command.v_mps[0] > 0) == drives_forwards
        assert command.omega_radps[0] == pytest.approx(bearing if drives_forwards else bearing - np.pi)


@pytest.mark.parametrize(
    ("bearing_deg", "drives", "turns"),
    [
        (30, 1, 1),
        (-30, 1, -1),
        (150, -1, -1),
        (-150, -1, 1),
        (0, 1, 0),
        (89, 1, 1),
        (91, -1, -1),
        (-91, -1, 1),
    ],
)
def test_unicycle_law_signs_in_all_quadrants(bearing_deg, drives, turns) -> None:
    """Goal ahead left: forward, left. Goal behind left: backwards, tail first, so to the right; and so on."""
    rho = np.array([0.8 * np.exp(1j * np.radians(bearing_deg))])
    v, omega = unicycle_law(rho, MarkerGains(0.5, 2.0, 0.0, 0.25))
    assert (np.sign(v[0]), np.sign(np.round(omega[0], 12))) == (drives, turns)
    expected_v, expected_omega = paper_law(
        0.8, in_half_open(np.pi - np.radians(bearing_deg)), 0.5 * 0.25, 2.0
    )
    assert v[0] == pytest.approx(expected_v, abs=ROUNDING)
    assert omega[0] == pytest.approx(expected_omega, abs=ROUNDING)


@pytest.mark.smoke
@pytest.mark.parametrize(
    "gains", [PixelGains(0.02, 0.7, 0.0), MarkerGains(0.1, 0.7, 0.0, 0.2)], ids=["px", "side"]
)
def test_unicycle_law_equals_equations_7_and_8(gains) -> None:
    rng = np.random.default_rng(2)
    rho = rng.uniform(0, 50, 2000) * np.exp(1j * rng.uniform(-np.pi, np.pi, 2000))
    v, omega = unicycle_law(rho, gains)
    alpha = np.pi - np.arctan2(rho.imag, rho.real)  # equation 6
    expected = [paper_law(abs(r), in_half_open(a), 0.02, 0.7) for r, a in zip(rho, alpha, strict=True)]
    np.testing.assert_allclose(np.column_stack([v, omega]), expected, rtol=0, atol=ROUNDING)
    assert np.abs(omega).max() <= 0.7 * np.pi / 2 + ROUNDING, "|alpha - alpha_d| <= pi/2"


@pytest.mark.parametrize("sense", [1, -1], ids=["left", "right"])
def test_goal_at_right_angle_turns_in_place(sense) -> None:
    """`If cos alpha = 0, v = 0 and robot i can rotate in place but not translate`; alpha_d = 0 there.

    alpha = pi - bearing = +pi/2 for a goal on the left: omega = -k pi/2, tail first. Exact: rho = ±i.
    """
    v, omega = unicycle_law(np.array([sense * 5j]), MarkerGains(0.1, 2.0, 0.0, 0.5))
    assert omega[0] == pytest.approx(-sense * 2.0 * np.pi / 2, abs=ROUNDING)
    assert v[0] == 0.0


@pytest.mark.parametrize("bearing", [np.pi, -np.pi])
def test_goal_behind_is_reached_backwards_without_turning(bearing) -> None:
    v, omega = unicycle_law(np.array([3 * np.exp(1j * bearing)]), MarkerGains(0.1, 2.0, 0.0, 0.5))
    assert v[0] == pytest.approx(-0.15)
    assert omega[0] == pytest.approx(0.0, abs=ROUNDING)


def test_robot_without_goal_stops() -> None:
    """alpha_m is 0 where rho is 0: v = omega = 0, exactly, and no NaN."""
    v, omega = unicycle_law(np.array([0j, -0.0 + 0j]), PixelGains(0.1, 2.0, 0.0))
    np.testing.assert_array_equal(np.abs([v, omega]), 0.0)


@pytest.mark.parametrize(
    ("gains", "scale"),
    [(PixelGains(0.01, 1.0, 10.0), 1.0), (MarkerGains(0.1, 1.0, 0.5, 0.3), 20.0)],
    ids=["10 px", "half a marker side"],
)
def test_robot_below_threshold_stops(gains, scale) -> None:
    """v = omega = 0 if rho_m < b_th (Corollary 2), in px or in marker sides, here of 20 px."""
    rho = gains.b_th * scale * np.array([0.999, 1.0, 1.001]) * np.exp(0.4j)
    rho[1] = gains.b_th * scale  # exactly at the threshold: not below it
    command = robot_commands(one_inbox(rho), gains, 0.0)
    assert command.v_mps[0] == command.omega_radps[0] == 0.0
    assert (command.v_mps[1:] > 0).all()
    assert command.omega_radps[2] == pytest.approx(0.4)


def test_marker_gains_give_speed_per_metre() -> None:
    """rho = side_m · rho_px / side_px metres, v = k rho: 40 px at 20 px a side of 0.3 m are 0.6 m."""
    command = robot_commands(one_inbox(np.array([40.0 + 0j])), MarkerGains(0.5, 1.0, 0.0, 0.3), 0.0)
    assert command.v_mps[0] == pytest.approx(0.5 * 0.6, rel=1e-14)


def test_pixel_gains_give_speed_per_pixel() -> None:
    command = robot_commands(one_inbox(np.array([40.0 + 0j])), PixelGains(0.002, 1.0, 0.0), 0.0)
    assert command.v_mps[0] == pytest.approx(0.08, rel=1e-14)


def test_wrap_angle_is_half_open() -> None:
    angles = np.array([-np.pi, np.pi, 3 * np.pi, -3 * np.pi, 0.0])
    np.testing.assert_array_equal(wrap_angle(angles), [-np.pi, -np.pi, -np.pi, -np.pi, 0.0])


@pytest.mark.parametrize("rho", [30 + 5j, 5 + 30j, -20 - 20j, 0.1 + 0.1j])
def test_offset_law_drives_marker_straight_at_limits(rho) -> None:
    """Its centre moves at `v + i l ω`, along ρ and within both limits; one of them is reached."""
    gains, wheels = MarkerGains(0.5, 1.0, 0.0, side_m=0.3), Wheels(0.4, 2.0, axis_offset_m=0.1)
    (v,), (omega,) = wheel_law(np.array([rho]), gains, wheels)
    motion, wanted = v + 1j * wheels.axis_offset_m * omega, 0.5 * 0.3 * rho
    assert (motion / wanted).imag == pytest.approx(0, abs=ROUNDING)
    used = max(abs(v) / wheels.max_speed_mps, abs(omega) / wheels.max_turn_radps)
    excess = max(abs(wanted.real) / 0.4, abs(wanted.imag) / 0.1 / 2.0)
    assert used == pytest.approx(min(1.0, excess))


@pytest.mark.parametrize("gains", [MarkerGains(0.3, 1.2, 0.02, side_m=0.1), PixelGains(0.3, 1.2, 0.02)])
def test_goal_without_finite_speed_stops_its_robot_alone(gains) -> None:
    inboxes = one_inbox(np.array([1e200 * np.exp(1j), 30.0]))
    inboxes.sides_px[0] = [1e-200, 20.0]
    with np.errstate(all="ignore"):
        command = robot_commands(inboxes, gains, 0.0, wheels=Wheels(0.3, 2.0))
    assert np.isfinite(command.v_mps).all() and np.isfinite(command.omega_radps).all()
    assert command.v_mps[1] != 0.0
    strange = finite_command(np.arange(3), np.array([np.nan, 0.1, 0.2]), np.array([1.0, np.inf, -1.0]))
    assert strange.v_mps.tolist() == [0.0, 0.0, 0.2] and strange.omega_radps.tolist() == [0.0, 0.0, -1.0]
