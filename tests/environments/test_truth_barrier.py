"""Observations depend on images and messages alone, and never on the true state or the calibration."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

from skyherd.environments import FormationEnv, formation_env
from skyherd.geometry import BoolArray
from skyherd.loop import run_steps

KINDS = list(itertools.product(("vectors", "detections", "images"), ("wheels", "flight")))
SMALL = {
    "duration_s": 0.5,
    "units.*.camera.size_px": [400, 400],
    "units.*.camera.principal_point_px": [201, 198],
}


def play(env, seed=3):
    """Return observations, states and rewards of an episode under fixed random actions."""
    rng = np.random.default_rng(1)
    observations, _ = env.reset(seed=seed)
    seen, states, rewards = [observations], [env.state()], []
    while env.agents:
        actions = {agent: rng.uniform(-1, 1, env.action_space(agent).shape) for agent in env.agents}
        observations, reward, _, _, _ = env.step(actions)
        seen.append(observations)
        states.append(env.state())
        rewards.append(list(reward.values()))
    return seen, np.array(states), np.array(rewards)


def false_truth(step):
    """Return a step with another true state; images, decisions and messages stay."""
    frames = {
        unit: replace(
            frame,
            sight=replace(
                frame.sight,
                whole_ids=frame.sight.whole_ids[:1],
                found_ids=frame.sight.whole_ids[:0],
                false_detections=9,
            ),
        )
        for unit, frame in step.frames.items()
    }
    shape = replace(step.metrics.shape, error=0.123)
    return replace(
        step,
        frames=frames,
        positions_m=step.positions_m[::-1] + 7.0,
        headings_rad=step.headings_rad[::-1] + 1.0,
        fleet=replace(step.fleet, heights_m=step.fleet.heights_m * 3, yaws_rad=step.fleet.yaws_rad + 2),
        metrics=replace(step.metrics, V=99.0, shape=shape),
        roles=step.roles[::-1],
    )


@pytest.mark.parametrize(("observations", "actions"), KINDS)
def test_another_true_state_changes_no_observation(observations, actions, monkeypatch):
    perception = "rendered" if observations == "images" else "noisy"
    settings = {**SMALL, "perception": perception, "avoidance.on": True, "robots.body_radius_sides": 0.6}
    if perception == "rendered":
        settings["duration_s"] = 0.2
    env = FormationEnv("star", settings, observations=observations, actions=actions)
    seen, states, rewards = play(env)

    def falsified(*arguments, **options):
        run = run_steps(*arguments, **options)
        step, asked = next(run), None
        while True:
            asked = yield false_truth(step)
            try:
                step = run.send(asked)
            except StopIteration:
                return

    monkeypatch.setattr(formation_env, "run_steps", falsified)
    again, other_states, other_rewards = play(env)
    assert data_equivalence(again, seen)
    assert (other_states[:, 1:] != states[:, 1:]).mean() > 0.5
    assert (other_rewards != rewards).all()


def doubled(tree: dict[str, object]) -> dict[str, object]:
    """Return settings of the scenario triangle with all lengths twice as large."""
    return {key: (2 * np.array(value)).tolist() for key, value in tree.items()}


LENGTHS = {
    "robots.positions_m": [[2.0, 5.5], [-3.25, 1.75], [-2.5, 0.5], [1.0, 3.0], [1.75, 2.0], [5.75, 0.0]],
    "robots.max_speed_mps": 1.0,
    "marker.side_m": 0.5,
    "units.0.height_m": 10.5,
    "units.0.flight.climb_gain_mps": 2.0,
    "units.0.flight.lateral_gain_mps": 4.0,
    "units.0.flight.speed_mps": 0.25,
    "autopilot.max_speed_mps": 2.0,
    "autopilot.max_climb_mps": 1.0,
    "autopilot.min_height_m": 3.0,
    "autopilot.max_height_m": 100.0,
}


@pytest.mark.parametrize("actions", ["wheels", "flight"])
@pytest.mark.parametrize("observations", ["vectors", "detections"])
def test_world_of_twice_the_size_looks_the_same(observations, actions):
    def make(lengths):
        settings = {"perception": "ideal", "duration_s": 2.0, **lengths}
        return FormationEnv("triangle", settings, observations=observations, actions=actions)

    seen, states, _ = play(make(LENGTHS))
    again, larger, _ = play(make(doubled(LENGTHS)))
    # A factor of 2 changes no digit of a number.
    assert data_equivalence(again, seen)
    np.testing.assert_array_equal(larger[:, 1:3], 2 * states[:, 1:3])
    robots_alone, _, _ = play(make({**LENGTHS, "robots.positions_m": doubled(LENGTHS)["robots.positions_m"]}))
    assert not data_equivalence(robots_alone, seen)


@pytest.mark.parametrize("observations", ["vectors", "images"])
def test_other_calibration_with_the_same_images_looks_the_same(observations):
    """A camera twice as high with twice the focal length takes the same images of the ground."""

    def make(height_m, half_angle_deg):
        settings = {
            **SMALL,
            "perception": "rendered" if observations == "images" else "ideal",
            "duration_s": 0.4,
            "units.0.height_m": height_m,
            "units.0.camera.half_angle_deg": half_angle_deg,
            "units.0.flight.kind": "hover",
        }
        return FormationEnv("triangle", settings, observations=observations)

    low, high = make(10.7, 42.0), make(21.4, float(np.degrees(np.arctan(np.tan(np.radians(42.0)) / 2))))
    (seen, states, _), (again, others, _) = play(low), play(high)
    height = 1 + 4 * 6 + 2
    np.testing.assert_allclose(others[:, height], 2 * states[:, height])
    for one, other in zip(seen, again, strict=True):
        for agent in one:
            first, second = (
                (one[agent], other[agent])
                if observations == "vectors"
                else (one[agent]["unit_0"], other[agent]["unit_0"])
            )
            # Focal lengths agree to 1e-15; a pixel may fall on either side of a rounding.
            np.testing.assert_allclose(
                first.astype(float), second.astype(float), atol=1e-5 if observations == "vectors" else 1
            )
            equal: BoolArray = first == second
            assert observations == "vectors" or equal.mean() > 0.999
