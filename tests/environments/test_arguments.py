"""Invalid arguments give one line; pictures and summaries of episodes."""

import numpy as np
import pytest

from skyherd.datasets import load_mission
from skyherd.environments import FormationEnv
from skyherd.errors import InputError
from skyherd.loop import run_steps

IDEAL = {"perception": "ideal", "duration_s": 0.3}


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"scenario": "triangel"}, "did you mean 'triangle'"),
        ({"settings": {"robot.count": 3}}, "settings: robot.count"),
        (
            {"observations": "pixels"},
            "FormationEnv: observations: 'pixels'; one of vectors, detections, images",
        ),
        ({"observations": "image"}, "did you mean 'images'"),
        ({"observations": "images"}, "none with perception ideal"),
        ({"actions": "wheel"}, "did you mean 'wheels'"),
        ({"rewards": "shapes"}, "did you mean 'shape'"),
        ({"rewards": {"shape": np.inf}}, "weight of shape: inf; a finite number"),
        ({"rewards": 3}, "rewards: 3; one of shape, progress"),
        ({"bodies": -1}, "bodies: -1; a whole number from 0 to 64"),
        ({"image_size_px": 84}, "image_size_px: 84; a width and a height"),
        ({"image_size_px": (84, 0)}, "a width and a height"),
        ({"scaled": "no"}, "scaled: 'no'; True or False"),
        ({"render_mode": "human"}, "render_mode: 'human'; one of rgb_array"),
        ({"render_mode": "rgb_array", "view": "unit_7"}, "one of ground, unit_0"),
        ({"render_mode": "rgb_array", "view": "unit_0"}, "no images with perception ideal"),
        (
            {"settings": {**IDEAL, "control.method": "bearing-only"}},
            "control.method: bearing-only; similarity",
        ),
    ],
)
def test_invalid_argument_gives_one_clear_line(options, line):
    given = {"scenario": "triangle", "settings": IDEAL, **options}
    with pytest.raises(InputError) as error:
        FormationEnv(given.pop("scenario"), given.pop("settings"), **given)
    assert line in str(error.value)
    assert "\n" not in str(error.value)


def test_invalid_call_gives_one_clear_line():
    env = FormationEnv("triangle", IDEAL)
    for call in (env.state, env.render, env.summary):
        with pytest.raises(InputError, match="reset"):
            call()
    for seed in (-1, 1.5, "a"):
        with pytest.raises(InputError, match=r"FormationEnv\.reset: seed"):
            env.reset(seed=seed)
    env.reset()
    still = {agent: [0.0, 0.0] for agent in env.agents}
    with pytest.raises(InputError, match="none for robot_2, robot_5"):
        env.step({agent: action for agent, action in still.items() if agent not in ("robot_2", "robot_5")})
    for action in ([0.0], [0.0, np.nan], "fast", None, [[0.0, 0.0]]):
        with pytest.raises(InputError, match=r"action of robot_3: .*; 2 finite numbers"):
            env.step({**still, "robot_3": action})
    with pytest.raises(InputError, match="render_mode='rgb_array'"):
        env.render()
    with pytest.raises(InputError, match="keep_steps=True"):
        env.summary()
    assert env.step(still)[4]["robot_0"]["time_s"] == pytest.approx(0.1)
    env.close()
    with pytest.raises(InputError, match="reset"):
        env.step(still)


def test_ground_picture_follows_the_robots():
    env = FormationEnv("triangle", IDEAL, render_mode="rgb_array")
    env.reset()
    first = env.render()
    env.step({agent: [1.0, 0.0] for agent in env.agents})
    second = env.render()
    assert first.shape == second.shape == (640, 640, 3)
    assert first.dtype == np.uint8
    assert 0.001 < (first != second).any(axis=2).mean() < 0.5


def test_unit_picture_is_its_image():
    settings = {"duration_s": 0.1}
    env = FormationEnv("triangle", settings, render_mode="rgb_array", view="unit_0")
    env.reset(seed=3)
    image = next(run_steps(load_mission("triangle", settings, seed=3))).frames[0].sight.image
    np.testing.assert_array_equal(env.render(), np.dstack([image] * 3))


def test_summary_counts_what_the_robots_did():
    env = FormationEnv("triangle", IDEAL, keep_steps=True)
    env.reset()
    while env.agents:
        env.step({agent: [0.5, 0.0] for agent in env.agents})
    speed_mps = 0.5 * load_mission("triangle").scenario.robots.max_speed_mps
    assert env.summary()["path_length_m"] == pytest.approx(6 * 0.3 * speed_mps)
    env.reset()
    assert env.summary()["path_length_m"] == 0.0
