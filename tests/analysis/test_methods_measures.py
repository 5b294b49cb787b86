"""Measures for comparing methods: affine images, shortest path, waypoints, and traffic."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from skyherd.analysis.history import WAYPOINTS, make_history
from skyherd.analysis.shortest_paths import shortest_path
from skyherd.analysis.traffic import count_traffic
from skyherd.control import AerialController, GoalFollowers
from skyherd.datasets import load_mission
from skyherd.loop import run_steps
from skyherd.sim.baseline_laws import LAWS
from skyherd.sim.truth_metrics import affine_error, fit_shape

LAW = [
    "perception=ideal",
    "roles.exchange=false",
    "avoidance.on=false",
    "size.min_spacing_sides=0",
    "units.*.frame_rate_hz=1",
    "step_s=0.2",
]


def cloud(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.standard_normal(count) + 1j * rng.standard_normal(count)


def test_affine_error_is_zero_for_affine_image() -> None:
    rng = np.random.default_rng(1)
    shape = cloud(rng, 9)
    image = 2.0 + shape.real * (0.3 + 1j) + shape.imag * (2.0 - 0.1j)
    assert affine_error(shape, image) < 1e-14
    assert fit_shape(shape, image).error > 0.3


def test_affine_error_is_minimal() -> None:
    rng = np.random.default_rng(2)
    shape, places = cloud(rng, 9), cloud(rng, 9)
    error, radius = affine_error(shape, places), np.linalg.norm(places - places.mean())
    for _ in range(200):
        a, b, c = cloud(rng, 3)
        other = np.linalg.norm(places - (a + shape.real * b + shape.imag * c)) / radius
        assert error < other
    assert error <= fit_shape(shape, places).error
    assert error == pytest.approx(affine_error(shape, 3.0 + 2j * places), rel=1e-12)


@pytest.fixture(scope="module")
def history():
    mission = load_mission("crowd", [*LAW, "control.method=affine-modules", "duration_s=20", "control.k=4.8"])
    return make_history(mission, run_steps(mission))


def test_affine_time_requires_hold_to_end(history) -> None:
    errors, times_s = history.affine_error, history.times_s
    assert errors.shape == times_s.shape
    for limit in (errors[60], errors[-1] * 0.5, errors[-12]):
        goal = history.mission.scenario.goal.model_copy(update={"shape_error": float(limit), "hold_s": 5.0})
        scenario = history.mission.scenario.model_copy(update={"goal": goal})
        reached_s = replace(history, mission=replace(history.mission, scenario=scenario)).affine_reached_s
        under = [row for row in range(len(times_s)) if (errors[row:] < limit).all()]
        held = bool(under) and times_s[under[0]] <= times_s[-1] - 5.0
        assert np.isnan(reached_s) if not held else reached_s == times_s[under[0]]


def test_waypoints_cover_start_to_end(history) -> None:
    places = history.waypoints_m
    assert places.shape == (WAYPOINTS, 16, 2)
    np.testing.assert_allclose(places[[0, -1]], history.positions_m[[0, -1]], atol=0.0006)


def test_min_path_depends_on_start_only(history) -> None:
    template = history.mission.template.points_of(history.ids).conj()
    start = history.positions_m[0] @ np.array([1, 1j])
    fixed = shortest_path(template, start, classes=np.arange(16)).length
    assert 0 < history.min_path_m <= fixed
    other = replace(history, positions_m=history.positions_m[:1])
    assert other.min_path_m == history.min_path_m


@pytest.mark.parametrize("method", LAWS)
def test_law_traffic_counts_links_and_steps(method) -> None:
    """Counted by hand: five steps of 0.2 s are a second."""
    settings = [*LAW, f"control.method={method}", "duration_s=0.8", "size.unit_m=4"]
    mission = load_mission("crowd", settings)
    history = make_history(mission, run_steps(mission))
    shape = mission.template.points_of(mission.ids).conj() * 4
    links = len(LAWS[method].links(shape))
    assert history.messages_per_robot_s == pytest.approx(5 * links / 16)
    assert history.numbers_per_robot_s == pytest.approx(5 * links * LAWS[method].numbers / 16)


def test_user_law_traffic_is_unknown(tmp_path, monkeypatch) -> None:
    (tmp_path / "still_law.py").write_text(
        "def still(shape, gain_ps):\n    return lambda places: 0 * places\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    mission = load_mission("crowd", [*LAW, "control.method=still_law:still", "duration_s=0.4"])
    history = make_history(mission, run_steps(mission))
    assert np.isnan([history.messages_per_robot_s, history.numbers_per_robot_s]).all()


def test_unit_traffic_counts_messages_per_receiver(monkeypatch) -> None:
    """Counted beside the loop: each robot's part of goals and proximity, and each report of a unit."""
    received, reports = [], []
    decide, step = GoalFollowers.decide, AerialController.step

    def listening(team, time_s, delivered):
        received.extend(delivery.message for delivery in delivered)
        return decide(team, time_s, delivered)

    def reporting(controller, *arguments):
        decision = step(controller, *arguments)
        reports.append(decision.report)
        return decision

    monkeypatch.setattr(GoalFollowers, "decide", listening)
    monkeypatch.setattr(AerialController, "step", reporting)
    mission = load_mission(
        "crowd", ["perception=ideal", "duration_s=6", "step_s=0.2", "units.*.frame_rate_hz=5"]
    )
    history = make_history(mission, run_steps(mission))
    assert len(received) > 50 and len(reports) == history.frames
    assert history.traffic.messages == sum(map(len, received)) + len(reports)
    values = 0
    for message in received:
        if hasattr(message, "rho_px"):
            parts = [message.for_robot(robot) for robot in message.ids.tolist()]
            values += sum(3 + part.neighbor_ids.size for part in parts)
        else:
            values += 4 * message.robot_ids.size
    in_reports = history.traffic.numbers - values
    points = sum(report.points_px.size + report.ids.size for report in reports)
    assert points < in_reports < 12 * points


def test_traffic_does_not_import_recorded_law(tmp_path, monkeypatch) -> None:
    """A recording may be untrusted: nothing in it is run, and a user's law has unknown traffic."""
    (tmp_path / "strangers_law.py").write_text("raise SystemExit('this ran')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    traffic = count_traffic(load_mission("star", ["control.method=strangers_law:law"]), [])
    assert math.isnan(traffic.messages) and math.isnan(traffic.numbers)
    assert "strangers_law" not in sys.modules
