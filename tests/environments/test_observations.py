"""Values of observations against the geometry of the world."""

import numpy as np
import pytest

from skyherd.control import fit_similarity
from skyherd.datasets import load_mission
from skyherd.environments import FormationEnv
from skyherd.loop import run_steps

TRIANGLE = {"perception": "ideal", "duration_s": 4.0, "control.rectify": False}
STAR = {
    "perception": "ideal",
    "duration_s": 3.0,
    "robots.body_radius_sides": 0.8,
    "avoidance.on": True,
    "control.rectify": False,
}


def robots_of(env):
    """Return true positions, complex, m, and headings, rad, of an environment's robots."""
    count = sum(agent.startswith("robot") for agent in env.possible_agents)
    rows = env.state()[1 : 1 + 4 * count].reshape(-1, 4).astype(float)
    return rows[:, 0] + 1j * rows[:, 1], np.angle(rows[:, 2] + 1j * rows[:, 3])


def test_goals_point_to_the_best_fitting_shape():
    env, mission = FormationEnv("triangle", TRIANGLE), load_mission("triangle", TRIANGLE)
    rng = np.random.default_rng(4)
    seen, _ = env.reset()
    template = mission.template.points_of(mission.ids).conj()
    while env.agents:
        places, headings = robots_of(env)
        # One unit sees and controls all robots: their goals are the points of the best similarity.
        wanted = (fit_similarity(template, places)(template) - places) * np.exp(-1j * headings)
        goals = np.stack(list(seen.values()))
        sides = wanted / mission.scenario.marker.side_m
        np.testing.assert_allclose(goals[:, 0] + 1j * goals[:, 1], sides, atol=2e-4)  # state is float32
        np.testing.assert_array_equal(goals[:, 2], 1.0)
        actions = {agent: rng.uniform(-1, 1, 2) for agent in env.agents}
        seen = env.step(actions)[0]
        np.testing.assert_array_equal(
            np.stack(list(seen.values()))[:, 3:5], np.stack(list(actions.values())).astype(np.float32)
        )


def test_goal_is_absent_without_images():
    env = FormationEnv("triangle", {**TRIANGLE, "units.0.outages": [[0.15, 5.0]], "robots.timeout_s": 0.5})
    env.reset()
    has_goal = []
    while env.agents:
        seen = env.step({agent: [0.0, 0.0] for agent in env.agents})[0]
        has_goal.append(bool(seen["robot_0"][2]))
        if not has_goal[-1]:
            np.testing.assert_array_equal(seen["robot_0"][:2], 0.0)
    # The last image is of 0.1 s, so that goals are stale after 0.6 s.
    assert has_goal == [True] * 6 + [False] * 34


@pytest.mark.parametrize("rate_hz", [10.0, 2.0])
def test_bodies_are_where_they_are_while_robots_turn(rate_hz):
    """Between two images, bearings turn by the command that the wheels obey, and not by that of the law."""
    settings = {**STAR, "units.*.frame_rate_hz": rate_hz}
    env, mission = FormationEnv("star", settings, bodies=3), load_mission("star", settings)
    rng = np.random.default_rng(2)
    seen, _ = env.reset()
    side_m, reached = mission.scenario.marker.side_m, 0
    reach_sides = 2 * 0.8 + mission.scenario.avoidance.margin_sides
    while env.agents:
        places, headings = robots_of(env)
        for robot, vector in enumerate(seen.values()):
            bodies = vector[5:].reshape(-1, 3)
            bodies = bodies[bodies[:, 0] < 100.0]
            assert (np.diff(bodies[:, 0]) >= 0).all(), "the nearest body comes first"
            arms = (places - places[robot]) * np.exp(-1j * headings[robot]) / side_m
            shown = (bodies[:, 0] + reach_sides) * (bodies[:, 1] + 1j * bodies[:, 2])
            for body in shown[np.abs(bodies[:, 1] + 1j * bodies[:, 2]) > 0.5]:
                assert np.abs(arms - body).min() < 1e-3  # float32, of at most 10 sides
                reached += 1
        seen = env.step({agent: [0.0, rng.uniform(-1, 1)] for agent in env.agents})[0]
    assert reached > 100


def test_missing_bodies_are_far_and_fill_the_vector():
    env = FormationEnv("star", {**STAR, "duration_s": 0.1}, bodies=64)
    vector = env.reset()[0]["robot_0"]
    assert vector.shape == (5 + 3 * 64,)
    np.testing.assert_array_equal(vector[-3:], [100.0, 0.0, 0.0])
    assert env.observation_space("robot_0").shape == vector.shape


def test_rows_of_units_are_their_detections():
    settings = {**STAR, "duration_s": 0.3, "perception": "noisy"}
    mission = load_mission("star", settings, seed=4)
    steps = list(run_steps(mission))
    env = FormationEnv("star", settings, observations="detections", actions="flight", scaled=False)
    team = FormationEnv("star", settings, observations="detections", scaled=False)
    (seen, infos), (all_seen, orders) = env.reset(seed=4), team.reset(seed=4)
    for _ in steps[1:]:
        seen, _, _, _, infos = env.step({agent: info["reference_action"] for agent, info in infos.items()})
        all_seen, _, _, _, orders = team.step({a: info["reference_action"] for a, info in orders.items()})
    for unit, frame in steps[-1].frames.items():
        rows, detections = seen[f"unit_{unit}"], frame.sight.detections
        assert mission.ids[rows[:, 0] == 1].tolist() == sorted(detections.ids.tolist())
        for marker in detections:
            row = rows[mission.ids == marker.id][0]
            half_px = min(detections.image_size_px) / 2
            middle = (detections.image_size_px - 1) / 2
            np.testing.assert_allclose(row[1:3] * half_px + middle, marker.center_px, atol=1e-3)
            assert np.arctan2(row[4], row[3]) == pytest.approx(
                np.angle(np.exp(1j * marker.heading_rad)), abs=1e-6
            )
            assert row[5] * half_px == pytest.approx(marker.side_px, rel=1e-6)
        np.testing.assert_array_equal(rows[rows[:, 0] == 0], 0.0)
        for robot in range(mission.ids.size):
            own_first = np.append(robot, np.delete(np.arange(mission.ids.size), robot))
            np.testing.assert_array_equal(all_seen[f"robot_{mission.ids[robot]}"][unit], rows[own_first])


def test_images_are_those_of_the_run_and_resized_by_area():
    settings = {
        "duration_s": 0.1,
        "units.0.camera.size_px": [400, 300],
        "units.0.camera.principal_point_px": [201, 148],
    }
    image = next(run_steps(load_mission("triangle", settings, seed=2))).frames[0].sight.image
    own = FormationEnv("triangle", settings, observations="images", actions="flight").reset(seed=2)[0][
        "unit_0"
    ]
    np.testing.assert_array_equal(own[..., 0], image)
    env = FormationEnv("triangle", settings, observations="images", image_size_px=(100, 75))
    small = env.reset(seed=2)[0]["robot_5"]["unit_0"]
    assert small.shape == (75, 100, 1)
    means = image.reshape(75, 4, 100, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(small[..., 0], means, atol=0.51)
