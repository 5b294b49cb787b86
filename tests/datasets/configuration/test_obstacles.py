"""Obstacles with markers, and the room for bodies: from the scenario file to detections."""

from typing import Any

import numpy as np
import pytest

from skyherd.datasets import Mission, make_mission
from skyherd.datasets.configuration.bodies import Bodies
from skyherd.errors import InputError
from skyherd.loop import run_steps
from skyherd.messages import Detections
from skyherd.render import project
from skyherd.sim.perception import RenderedPerception, make_perception
from skyherd.sim.physics import make_world

OBSTACLES = [
    {"id": 41, "position_m": [0.4, 0.2], "heading_deg": 30.0},
    {"id": 7, "position_m": [-1.5, 1.0], "radius_sides": 2.0},
]


@pytest.fixture
def mission_of(scenario_tree) -> Any:
    """Return the triangle with two obstacles, in a given perception."""

    def make(perception: str = "ideal", obstacles: Any = None, **keys: Any) -> Mission:
        tree = scenario_tree("triangle")
        tree |= {"perception": perception, "obstacles": OBSTACLES if obstacles is None else obstacles}
        for key, value in keys.items():
            tree[key] = tree.get(key, {}) | value if isinstance(value, dict) else value
        return make_mission(tree)

    return make


def test_room_is_distance_less_radii() -> None:
    """The reference computes every pair: N (N - 1) / 2 of robots, N K of a robot and an obstacle."""
    rng = np.random.default_rng(1)
    places, obstacles, radii = rng.uniform(-3, 3, (7, 2)), rng.uniform(-3, 3, (3, 2)), rng.uniform(0, 1, 3)
    bodies = Bodies(0.4, obstacles, radii)
    everybody, reaches = np.concatenate([places, obstacles]), np.append(np.full(7, 0.4), radii)
    pairs, gaps = bodies.pairs(7), bodies.gaps_m(places)
    assert len(pairs) == len(gaps) == 21 + 21
    assert {tuple(pair) for pair in pairs.tolist()} == {(i, j) for i in range(7) for j in range(i + 1, 10)}
    for (i, j), gap in zip(pairs.tolist(), gaps.tolist(), strict=True):
        assert gap == pytest.approx(np.hypot(*(everybody[i] - everybody[j])) - reaches[i] - reaches[j])
    np.testing.assert_array_equal(bodies.overlapping(places), pairs[gaps < 0])


def test_a_missions_obstacles_ascend_by_id(mission_of) -> None:
    mission = mission_of(marker={"side_m": 0.5})
    assert mission.obstacle_ids.tolist() == [7, 41]
    assert mission.obstacle_positions_m.tolist() == [[-1.5, 1.0], [0.4, 0.2]]
    np.testing.assert_allclose(mission.obstacle_headings_rad, [0, np.pi / 6])
    assert mission.obstacle_radii_m.tolist() == [1.0, 0.5]
    assert mission_of(obstacles=[]).obstacle_positions_m.shape == (0, 2)


BAD = {
    "a_robots_id": ([{"id": 3, "position_m": [0, 0]}], {}, ["obstacles.0.id", "3", "robot 3"]),
    "twice": (
        [{"id": 30, "position_m": [0, 0]}, {"id": 30, "position_m": [2, 2]}],
        {},
        ["obstacles.1.id", "30", "obstacle 0"],
    ),
    "not_in_the_dictionary": ([{"id": 50, "position_m": [0, 0]}], {}, ["obstacles.0.id", "50", "0 to 49"]),
    "one_over_the_other": (
        [{"id": 30, "position_m": [0, 0]}, {"id": 31, "position_m": [0.1, 0]}],
        {},
        ["obstacles.1.position_m", "obstacle 30", "covers"],
    ),
    "on_a_robot": ([{"id": 30, "position_m": "robot 2"}], {}, ["robot 2", "overlaps obstacle 30"]),
    "in_a_robots_body": (
        [{"id": 30, "position_m": "beside robot 2", "radius_sides": 0.6}],
        {"body_radius_sides": 0.6},
        ["robot 2", "overlaps obstacle 30"],
    ),
    "two_bodies": (
        [],
        {"body_radius_sides": 5.0},
        ["robots.positions_m", "overlaps robot", "smaller bodies"],
    ),
    "no_radius": (
        [{"id": 30, "position_m": [0, 0], "radius_sides": 0}],
        {},
        ["obstacles.0.radius_sides: 0; a finite number from"],
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_said_in_one_line(mission_of, case: str) -> None:
    obstacles, robots, said = BAD[case]
    plain = mission_of()
    side_m = plain.scenario.marker.side_m
    places = {
        "robot 2": plain.positions_m[2].tolist(),
        "beside robot 2": (plain.positions_m[2] + [1.1 * side_m, 0]).tolist(),
    }
    given = [
        obstacle | {"position_m": places.get(str(obstacle["position_m"]), obstacle["position_m"])}
        for obstacle in obstacles
    ]
    with pytest.raises(InputError) as caught:
        mission_of(obstacles=given, robots=robots)
    message = str(caught.value)
    assert "\n" not in message
    for words in said:
        assert words in message, message


def test_bodies_that_only_touch_are_let_be(mission_of) -> None:
    obstacle = {"id": 30, "radius_sides": 0.6}
    plain = mission_of()
    reach_m = 1.2 * plain.scenario.marker.side_m
    place = (plain.positions_m[2] + [reach_m, 0]).tolist()
    mission_of(obstacles=[obstacle | {"position_m": place}], robots={"body_radius_sides": 0.6})


def test_a_scattered_start_leaves_room_to_every_body(scenario_tree) -> None:
    tree = scenario_tree("grid")
    tree["obstacles"] = [{"id": 45, "position_m": [0.0, 0.0], "radius_sides": 3.0}]
    tree["robots"]["body_radius_sides"] = 1.0
    for seed in range(5):
        mission = make_mission(tree | {"seed": seed})
        assert mission.bodies.gaps_m(mission.positions_m).min() >= 0
    tree["robots"]["body_radius_sides"] = 30.0
    with pytest.raises(InputError, match=r"no room .* smaller bodies"):
        make_mission(tree)


@pytest.mark.parametrize("perception", ["ideal", "noisy", "rendered"])
def test_obstacles_are_seen_like_robots_and_are_not_false(mission_of, perception: str) -> None:
    """Detections are within half a pixel of the projection: tens of the detector's standard deviations."""
    mission = mission_of(perception)
    world = make_world(mission)
    sight = make_perception(mission, np.random.default_rng(1)).look(world, [0], 0.0)[0]
    assert set(sight.whole_ids.tolist()) == {*mission.ids.tolist(), 7, 41}
    assert np.array_equal(np.sort(sight.found_ids), np.sort(sight.whole_ids))
    assert sight.false_detections == 0
    seen = sight.detections.select([7, 41])
    expected = project(world.cameras[0], world.camera_pose(0), mission.obstacle_positions_m)
    np.testing.assert_allclose(seen.centers_px[np.argsort(seen.ids)], expected, rtol=0, atol=0.5)


def test_what_is_no_marker_of_the_scene_stays_false(mission_of) -> None:
    """An obstacle's marker detected at a wrong position, and a marker that does not exist."""
    mission = mission_of("rendered")
    world, perception = make_world(mission), RenderedPerception(mission, np.random.default_rng(1))
    true = perception.look(world, [0], 0.0)[0].detections
    ids, shift = true.ids.copy(), np.zeros((len(true), 2))
    shift[ids == 41] = (0.6 * true.sides_px[ids == 41][0], 0)
    ids[ids == 2] = 33

    class Wrong:
        def detect(self, *_: Any, **__: Any) -> Detections:
            return Detections(
                **{
                    **vars(true),
                    "ids": ids,
                    "centers_px": true.centers_px + shift,
                    "corners_px": true.corners_px + shift[:, None],
                }
            )

    perception.detector = Wrong()  # type: ignore[assignment]
    sight = perception.look(world, [0], 0.0)[0]
    assert sight.false_detections == 2
    assert set(sight.whole_ids.tolist()) - set(sight.found_ids.tolist()) == {2, 41}


def test_obstacles_stand_still_while_robots_move(mission_of) -> None:
    mission = mission_of(duration_s=1.0, sensor={"exposure_s": 0.02})
    world = make_world(mission)
    for step in run_steps(mission):
        world.advance(step.command, step.time_s, 0.1)
    motion, markers = world.motion(0), world.markers
    assert motion.robots_mps is not None and motion.robots_radps is not None
    robots = mission.ids.size
    assert np.linalg.norm(motion.robots_mps[:robots], axis=1).max() > 0.01
    assert not motion.robots_mps[robots:].any() and not motion.robots_radps[robots:].any()
    assert len(motion.robots_mps) == len(markers.ids) == robots + 2
    np.testing.assert_array_equal(markers.positions_m[robots:], mission.obstacle_positions_m)


def test_the_controller_takes_no_obstacle_for_a_robot(mission_of) -> None:
    """The run is the same, to the bit, with and without them."""
    runs = [
        list(run_steps(mission_of(obstacles=obstacles, duration_s=5.0, control={"rectify": False})))
        for obstacles in (OBSTACLES, [])
    ]
    for with_obstacles, without in zip(*runs, strict=True):
        np.testing.assert_array_equal(with_obstacles.positions_m, without.positions_m)
        np.testing.assert_array_equal(with_obstacles.fleet.positions_m, without.fleet.positions_m)
    assert 41 in runs[0][0].frames[0].sight.detections.ids
