"""Agreement with PettingZoo, and determinism of episodes."""

import itertools
import subprocess
import sys

import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from pettingzoo.test import parallel_api_test, parallel_seed_test

from skyherd.datasets import load_mission
from skyherd.environments import FormationEnv
from skyherd.errors import InputError

KINDS = list(itertools.product(("vectors", "detections", "images"), ("wheels", "flight")))
SHORT = {"duration_s": 0.4, "units.*.camera.size_px": [400, 360]}


def make(observations, actions, scenario="triangle", **options):
    perception = "rendered" if observations == "images" else "noisy"
    duration_s = 0.2 if observations == "images" else 0.4
    settings = {
        **SHORT,
        "duration_s": duration_s,
        "perception": perception,
        "units.*.camera.principal_point_px": [201.0, 178.0],
    }
    return FormationEnv(scenario, settings, observations=observations, actions=actions, **options)


def episode(env, seed, draw_seed):
    """Return everything that an episode under random actions gives."""
    rng, given = np.random.default_rng(draw_seed), [env.reset(seed=seed)]
    while env.agents:
        actions = {a: rng.uniform(-1, 1, env.action_space(a).shape) for a in env.agents}
        given.append((env.step(actions), env.state()))
    return given


@pytest.mark.smoke
@pytest.mark.parametrize(("observations", "actions"), KINDS)
def test_environment_passes_the_tests_of_pettingzoo(observations, actions):
    parallel_api_test(make(observations, actions), num_cycles=10)
    parallel_seed_test(lambda: make(observations, actions), num_cycles=10)


@pytest.mark.parametrize(("observations", "actions"), KINDS)
def test_observations_and_actions_lie_in_their_spaces(observations, actions):
    env = make(observations, actions, "star", scaled=actions == "wheels")
    seen, infos = env.reset(seed=5)
    while env.agents:
        for agent in env.possible_agents:
            assert env.observation_space(agent).contains(seen[agent])
            assert env.action_space(agent).contains(infos[agent]["reference_action"])
        assert env.state_space.contains(env.state())
        seen, _, _, _, infos = env.step({a: env.action_space(a).sample() for a in env.agents})


def test_episode_depends_on_seed_and_actions_alone():
    used, fresh = make("vectors", "wheels", "crowd"), make("vectors", "wheels", "crowd")
    episode(used, 1, 7)
    assert data_equivalence(episode(used, 3, 7), episode(fresh, 3, 7))
    assert not data_equivalence(episode(used, 4, 7), episode(fresh, 3, 7))
    assert not data_equivalence(episode(used, 3, 8), episode(fresh, 3, 7))


def test_episodes_without_seed_repeat_after_a_seed():
    env = make("vectors", "wheels", "crowd")

    def seeds():
        return [next(iter(env.reset()[1].values()))["seed"] for _ in range(3)]

    assert seeds()[0] == load_mission("crowd").scenario.seed
    env.reset(seed=11)
    first = seeds()
    assert len(set(first)) == 3
    env.reset(seed=11)
    assert seeds() == first
    env.reset(seed=12)
    assert seeds() != first


def test_settings_of_an_episode_last_for_that_episode():
    env = make("vectors", "wheels")
    plain = env.reset(seed=2)[0]
    turned = env.reset(seed=2, options={"settings": {"robots.headings_deg": [0.0] * 6}})[0]
    assert not data_equivalence(plain, turned)
    assert data_equivalence(env.reset(seed=2)[0], plain)
    with pytest.raises(InputError, match="they change agents or spaces"):
        make("vectors", "wheels", "crowd").reset(
            options={"settings": {"robots.count": 15, "template.shape": "circle"}}
        )
    assert data_equivalence(env.step({a: [0, 0] for a in env.agents})[0].keys(), plain.keys())


def test_agents_are_truncated_at_the_end_of_the_scenario():
    env = make("vectors", "wheels")
    env.reset()
    ends = []
    while env.agents:
        _, _, terminated, truncated, infos = env.step({a: [0, 0] for a in env.agents})
        ends.append((set(terminated.values()), set(truncated.values()), infos["robot_0"]["time_s"]))
    assert [end[2] for end in ends] == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert [end[1] for end in ends] == [{False}] * 3 + [{True}]
    assert all(end[0] == {False} for end in ends)
    with pytest.raises(InputError, match="reset"):
        env.step({})


def test_agents_are_terminated_once_the_shape_is_held():
    held = {"goal.hold_s": 0.2, "goal.shape_error": 0.9}
    env = FormationEnv("triangle", {**SHORT, **held, "perception": "ideal"}, terminate_when_held=True)
    env.reset()
    outcomes = [env.step({a: [0, 0] for a in env.agents}) for _ in range(2)]
    assert [set(outcome[2].values()) for outcome in outcomes] == [{False}, {True}]
    assert env.agents == []
    never = FormationEnv(
        "triangle",
        {**SHORT, **held, "goal.shape_error": 0.1, "perception": "ideal"},
        terminate_when_held=True,
    )
    never.reset()
    outcomes = [never.step({a: [0, 0] for a in never.agents}) for _ in range(4)]
    assert [set(outcome[2].values()) for outcome in outcomes] == [{False}] * 4


def test_skyherd_works_without_pettingzoo():
    code = (
        "import sys, skyherd; skyherd.run_steps\n"
        "print('pettingzoo' in sys.modules, 'gymnasium' in sys.modules)\n"
        "sys.modules['pettingzoo'] = None\n"
        "from importlib import util; find = util.find_spec\n"
        "util.find_spec = lambda name: None if name == 'pettingzoo' else find(name)\n"
        "import skyherd.environments"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.stdout.split() == ["False", "False"]
    assert ended.stderr.splitlines()[-1].endswith("pettingzoo is not installed; pip install 'skyherd[rl]'")
