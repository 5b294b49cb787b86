"""Motion of the shape: the field, its leads in images, the units' drift, and teams of points and robots."""

import cmath
from dataclasses import replace

import numpy as np
import pytest

from skyherd.control import (
    AerialController,
    FlightTask,
    Follow,
    Hover,
    KeepInView,
    LeadRule,
    Perimeter,
    SafetyRadius,
    Schedule,
    ShapeMotion,
    Template,
    motion_goals,
)
from skyherd.control.formation.motion import drift_mps, leads_px
from skyherd.control.formation.similarity import fit_similarity
from skyherd.control.goals import led_goals, lyapunov_term
from skyherd.datasets import make_mission
from skyherd.errors import InputError
from skyherd.loop import run_steps

NO_ID = np.array([], dtype=np.int64)
MOTION = ShapeMotion(right_ps=0.2, down_ps=-0.1, turn_radps=0.3, growth_ps=0.05)
RULE = LeadRule(side_m=0.5, gain_ps=0.4)


def random_template(seed: int, count: int = 9) -> Template:
    rng = np.random.default_rng([seed, 41])
    return Template(np.arange(count), rng.normal(size=count) + 1j * rng.normal(size=count) + 3)


def moved(template: Template, motion: ShapeMotion, time_s: float) -> np.ndarray:
    """Return the points after a time, from the exact solution of the motion's differential equation.

    With b = g + i ω the shape's own factor is `e^{b t}`, and its mean has moved by `w R (e^{b t} - 1) / b`.
    """
    b = motion.growth_ps + 1j * motion.turn_radps
    mean = template.points_px.mean()
    velocity = (motion.right_ps + 1j * motion.down_ps) * template.radius_px
    return np.exp(b * time_s) * (template.points_px - mean) + mean + velocity * (np.exp(b * time_s) - 1) / b


@pytest.mark.parametrize("seed", range(3))
def test_velocities_are_derivative_of_moving_similarity(seed) -> None:
    template, step = random_template(seed), 1e-5
    derivative = (moved(template, MOTION, step) - moved(template, MOTION, -step)) / (2 * step)
    np.testing.assert_allclose(MOTION.velocities(template, template.points_px), derivative, rtol=1e-8)


def seen_by(camera: complex, template: Template, make_detections, shift: complex = 400 + 300j, **values):
    """Return detections of the shape under a camera's similarity, sides of a tenth of its scale."""
    sides = np.full(template.ids.size, abs(camera) / 10)
    return make_detections(template.ids, camera * template.points_px + shift, sides=sides, **values)


@pytest.mark.parametrize("seed", range(3))
def test_leads_in_marker_sides_are_equal_in_all_images(make_detections, seed) -> None:
    """Two cameras: leads turn with the camera; divided by sides they have the same length."""
    template = random_template(seed)
    cameras = (30.0 + 0j, 80 * cmath.exp(2.1j))
    leads = [
        leads_px(
            MOTION,
            RULE,
            template=template,
            seen=seen_by(camera, template, make_detections),
            ids=template.ids,
            reports=[],
        )
        for camera in cameras
    ]
    np.testing.assert_allclose(leads[0] / cameras[0], leads[1] / cameras[1], rtol=1e-9)
    expected = MOTION.velocities(template, template.points_px) / RULE.gain_ps
    np.testing.assert_allclose(leads[0] / cameras[0], expected, rtol=1e-9)


def test_leads_of_several_units_add_up_to_one(make_detections, make_report) -> None:
    """Robot 3 is controlled and seen by three units, 4 is controlled by another one that does not see it."""
    template = random_template(0)
    seen = seen_by(50.0, template, make_detections)
    reports = [
        make_report(1, [3, 5], [0, 1j], [3]),
        make_report(2, [3, 5], [0, 1j], [3, 4]),
    ]
    alone, together = (
        leads_px(MOTION, RULE, template=template, seen=seen, ids=template.ids, reports=others)
        for others in ([], reports)
    )
    shares = np.ones(9)
    shares[3] = 1 / 3
    np.testing.assert_allclose(together, alone * shares, rtol=1e-12)


@pytest.mark.parametrize(
    ("growth_ps", "scales", "grows"),
    [
        (0.05, (0.0, 49.9), False),
        (-0.05, (0.0, 49.9), True),
        (-0.05, (50.1, np.inf), False),
        (0.05, (50.1, np.inf), True),
    ],
)
def test_growth_ends_at_bound_of_size(make_detections, growth_ps, scales, grows) -> None:
    """The shape has a scale of 50 in the image."""
    template = random_template(1)
    leads = leads_px(
        ShapeMotion(growth_ps=growth_ps),
        RULE,
        template=template,
        seen=seen_by(50.0, template, make_detections),
        ids=template.ids,
        reports=[],
        scales=scales,
    )
    assert (np.abs(leads).max() > 1) == grows


@pytest.mark.parametrize(
    "law",
    [lambda template: Follow(), lambda template: Perimeter(), KeepInView],
    ids=["follow", "hull", "view"],
)
def test_units_fly_along_with_moving_shape(make_detections, law) -> None:
    """Detections are equal, so that commands differ by the drift alone; a hovering unit stays."""
    template, drift = random_template(0), np.array([0.3, -0.2])
    seen = seen_by(50.0, template, make_detections)
    rest, moving = FlightTask(template.ids), FlightTask(template.ids, drift_mps=drift)
    commands = [law(template).command(seen, task, []) for task in (rest, moving)]
    np.testing.assert_allclose(commands[1].lateral_mps - commands[0].lateral_mps, drift, atol=1e-12)
    assert not Hover().command(seen, moving, []).lateral_mps.any()


def test_led_goal_is_sum_of_vectors_in_robot_frame(make_detections) -> None:
    """By angles: in the image the led goal points to the sum of goal vector and lead."""
    rng = np.random.default_rng(5)
    template, headings = random_template(2), rng.uniform(-3, 3, 9)
    points = 400 + 400j + 100 * (rng.normal(size=9) + 1j * rng.normal(size=9))
    seen = make_detections(template.ids, points, headings=headings)
    goals = motion_goals(seen, template.ids, template, shared_ids=NO_ID, nearest=2)
    leads = 30 * (rng.normal(size=9) + 1j * rng.normal(size=9))
    led = led_goals(goals, seen, leads)

    def in_image(some) -> np.ndarray:
        return some.rho_px * np.exp(1j * (headings - some.bearings_rad))

    np.testing.assert_allclose(in_image(led), in_image(goals) + leads, atol=1e-9)
    np.testing.assert_array_equal(led.neighbor_distances_px, goals.neighbor_distances_px)


def test_drift_keeps_shape_in_place_below_unit(make_detections) -> None:
    """The shape's point at the image centre moves at the drift, by finite differences in the image."""
    template, camera, center = random_template(3), 60 * cmath.exp(0.7j), 399.5 + 399.5j
    seen = seen_by(camera, template, make_detections, headings=np.zeros(9))
    point = (center - (400 + 300j)) / camera
    step = 1e-5
    fit = fit_similarity(template.points_px, moved(template, MOTION, step))
    displaced_px = camera * (fit(np.array([point]))[0] - point)
    metres_in_px = RULE.side_m / (abs(camera) / 10)
    drift = drift_mps(MOTION, RULE, template=template, seen=seen, center_px=center)
    assert complex(*drift) == pytest.approx(displaced_px / step * metres_in_px, rel=1e-4)


def test_drift_is_zero_without_similarity(make_detections) -> None:
    seen = make_detections([0], [1 + 1j])
    assert not drift_mps(MOTION, RULE, template=random_template(0), seen=seen, center_px=0j).any()


@pytest.mark.parametrize(("motion", "keeps"), [(MOTION, True), (ShapeMotion(0.2, -0.1, 0.3, -0.02), True)])
def test_points_under_two_units_follow_moving_shape_exactly(
    make_detections, make_report, motion, keeps
) -> None:
    """Points that integrate their goals, under units that share three of nine robots, in Euler steps.

    From a start in the shape they stay in it, and its place, rotation and size are those of the exact
    solution.
    """
    template, step = random_template(4), 0.005
    sets = [template.ids[:6], template.ids[3:]]
    points = template.points_px.copy()
    for _ in range(400):
        velocity = np.zeros(9, dtype=complex)
        for unit, own in enumerate(sets):
            other = make_report(1 - unit, template.ids, points, sets[1 - unit])
            seen = make_detections(template.ids, points)
            fit = fit_similarity(template.points_of(own), points[own])
            leads = leads_px(motion, RULE, template=template, seen=seen, ids=own, reports=[other])
            velocity[own] += RULE.gain_ps * (fit(template.points_of(own)) - points[own] + leads)
        points = points + step * velocity
    expected = moved(template, motion, 400 * step)
    assert np.abs(points - expected).max() < 0.005 * template.radius_px
    assert np.abs(points - template.points_px).max() > 0.2 * template.radius_px


def test_schedule_returns_motion_from_its_time_on() -> None:
    program = Schedule(random_template(0), motions=((5.0, MOTION), (8.0, ShapeMotion())))
    assert [program.motion_at(t) for t in (0.0, 4.9, 5.0, 8.0)] == [
        ShapeMotion(),
        ShapeMotion(),
        MOTION,
        ShapeMotion(),
    ]
    with pytest.raises(InputError, match="ascend"):
        Schedule(random_template(0), motions=((5.0, MOTION), (5.0, MOTION)))


def test_controller_of_moving_shape_needs_robots_response(make_detections) -> None:
    """Its Lyapunov term is that of the error alone, as if the shape rested."""
    template = random_template(6)
    schedule = Schedule(template, motions=((0.0, MOTION),))
    with pytest.raises(InputError, match="a LeadRule"):
        AerialController(schedule, SafetyRadius(), Hover())
    rng = np.random.default_rng(1)
    points = 400 + 400j + 60 * (rng.normal(size=9) + 1j * rng.normal(size=9))
    seen = make_detections(template.ids, points)
    moving = AerialController(schedule, SafetyRadius(), Hover(), lead=RULE).step(seen)
    resting = AerialController(template, SafetyRadius(), Hover(), lead=RULE).step(seen)
    assert moving.report.cost_sides2 == resting.report.cost_sides2 == lyapunov_term(resting.goals)
    assert np.abs(moving.goals.rho_px - resting.goals.rho_px).max() > 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"control": {"gains": "pixel"}}, r"template\.motion.*marker gains"),
        ({"size": {"spacing_sides": 3.0}}, r"template\.motion\.1\.growth_percent_ps.*0, or no"),
        ({"control": {"method": "bearing-only"}}, r"template\.motion.*not supported"),
    ],
)
def test_scenario_rejects_impossible_motion(scenario_tree, change, said) -> None:
    tree = scenario_tree("circle")
    tree["template"]["motion"] = [{"at_s": 0.0, "turn_degps": 1.0}, {"at_s": 5.0, "growth_percent_ps": 1.0}]
    make_mission(tree)
    for key, values in change.items():
        tree[key] = tree.get(key, {}) | values
    with pytest.raises(InputError, match=said):
        make_mission(tree)


def test_scenario_rejects_motions_that_do_not_ascend(scenario_tree) -> None:
    tree = scenario_tree("circle")
    tree["template"]["motion"] = [{"at_s": 5.0}, {"at_s": 5.0}]
    with pytest.raises(InputError, match=r"template\.motion.*ascend"):
        make_mission(tree)


def moving_circle(tree: dict, **control) -> dict:
    """Return the scenario of twelve robots and three units that start on their circle, which then moves."""
    angles = np.radians(30.0 * np.arange(12))
    places = 5.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    tree["robots"] = {"positions_m": places.tolist(), "headings_deg": np.degrees(angles).tolist()}
    tree["template"]["motion"] = [
        {"at_s": 0.0, "velocity_ps": [0.05, 0.0], "turn_degps": 2.0, "growth_percent_ps": -0.3}
    ]
    return tree | {
        "perception": "ideal",
        "duration_s": 60.0,
        "roles": {"exchange": False},
        "control": tree["control"] | control,
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("latency_s", "compensation"), [(0.0, False), (0.3, False), (0.3, True)], ids=["0", "0.3", "compensated"]
)
def test_circle_of_robots_moves_at_its_rates(scenario_tree, latency_s, compensation) -> None:
    """Robots are unicycles at up to 0.45 m/s that begin in other directions: error below 2 % after 20 s.

    Speed, turn and growth are those of the scenario; without the age of the image in the lead, compensated
    robots would be 8 % slow.
    """
    tree = moving_circle(scenario_tree("circle"), latency_compensation=compensation)
    for unit in tree["units"]:
        unit["latency_s"] = latency_s
    mission = make_mission(tree)
    steps = [step for step in run_steps(mission) if step.time_s >= 20.0]
    shapes = [step.metrics.shape for step in steps]
    assert max(shape.error for shape in shapes) < 0.02
    middles = np.array([step.positions_m.mean(axis=0) @ [1, 1j] for step in steps])
    scales, passed_s = np.array([shape.scale for shape in shapes]), steps[-1].time_s - steps[0].time_s
    radius_m = scales * mission.template.radius_px
    path_m = np.abs(np.diff(middles)).sum()
    assert path_m / (0.05 * radius_m.mean() * passed_s) == pytest.approx(1, abs=0.02)
    turn = np.unwrap([shape.rotation_rad for shape in shapes])
    assert np.degrees(turn[-1] - turn[0]) / passed_s == pytest.approx(2.0, rel=0.02)
    assert np.log(scales[-1] / scales[0]) / passed_s == pytest.approx(-0.003, rel=0.1)


def test_lead_anticipates_turn_and_age() -> None:
    """A robot is behind a turn by its lag; its motion since the image is added to the goal of each unit."""
    rule, shares = replace(RULE, turn_lag_s=2.0), np.array([1.0, 0.5])
    np.testing.assert_allclose(rule.lead_s(0.1, shares), shares * cmath.exp(0.2j) / 0.4)
    aged = replace(RULE, age_s=0.5)
    np.testing.assert_allclose(aged.lead_s(0.0, shares), shares / 0.4 + 0.5)
    arc = sum(cmath.exp(0.4j * (k + 0.5) * 0.0005) * 0.0005 for k in range(1000))
    np.testing.assert_allclose(aged.lead_s(0.4, shares), shares * cmath.exp(0.2j) / 0.4 + arc, rtol=1e-2)
