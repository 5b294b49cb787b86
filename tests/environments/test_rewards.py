"""Rewards: built-in ones against the steps, own functions, and errors."""

import numpy as np
import pytest

from skyherd.environments import FormationEnv
from skyherd.errors import InputError

IDEAL = {"perception": "ideal", "duration_s": 1.0, "robots.body_radius_sides": 0.5}


def rewards(given, settings=IDEAL, actions=None, **options):
    """Return the rewards (T, A) of an episode."""
    env = FormationEnv("triangle", settings, rewards=given, **options)
    env.reset()
    rows = []
    while env.agents:
        action = env.action_space(env.agents[0]).low * 0 if actions is None else actions
        rows.append(list(env.step({agent: action for agent in env.agents})[1].values()))
    return np.array(rows)


def test_progress_adds_up_to_the_decrease_of_the_shape_error():
    kept = []

    def keep(transition):
        kept.append((transition.before.metrics.shape.error, transition.after.metrics.shape.error))
        return 0.0

    given = rewards({"progress": 1.0, keep: 1.0}, actions=[0.8, 0.3])
    np.testing.assert_allclose(given.sum(axis=0), kept[0][0] - kept[-1][1], atol=1e-12)
    assert abs(kept[0][0] - kept[-1][1]) > 0.01
    np.testing.assert_allclose(rewards("shape", actions=[0.8, 0.3])[:, 2], [-after for _, after in kept])


def test_contacts_cost_the_touching_robots_alone():
    places = [[0.0, 0.0], [0.55, 0.0], [3.0, 0.0], [3.0, 2.0], [-3.0, 0.0], [-3.0, 0.52]]
    headings = [0.0, 180.0, 0.0, 0.0, 0.0, 0.0]
    settings = {**IDEAL, "duration_s": 0.1, "robots.positions_m": places, "robots.headings_deg": headings}
    # Bodies are 0.5 m wide. Robots 0 and 1 approach by 0.1 m; 4 and 5 stay 2 cm apart.
    np.testing.assert_array_equal(
        rewards("contacts", settings, actions=[0.5, 0.0]), [[-1.0, -1.0, 0.0, 0.0, 0.0, 0.0]]
    )


def test_effort_is_that_of_the_executed_action():
    np.testing.assert_allclose(rewards("effort", actions=[0.5, -1.0]), -(0.25 + 1.0) / 2)
    np.testing.assert_allclose(rewards("effort", actions=[7.0, 0.0]), -0.5)


def test_weights_add_rewards_of_names_and_functions():
    def own(transition):
        return np.arange(6.0)

    total = rewards({"effort": 2.0, own: 0.5}, actions=[1.0, 0.0])
    np.testing.assert_allclose(total, np.tile(0.5 * np.arange(6.0) - 1.0, (len(total), 1)))
    np.testing.assert_allclose(rewards(lambda transition: 3.0, actions=[1.0, 0.0]), 3.0)


@pytest.mark.parametrize(
    ("given", "options", "line"),
    [
        (lambda t: [1.0, 2.0], {}, "one finite number, or 6, one an agent"),
        (lambda t: np.nan, {}, "one finite number, or 6, one an agent"),
        ("contacts", {"actions": "flight"}, "one finite number, or 1, one an agent"),
    ],
)
def test_reward_of_a_wrong_form_is_refused(given, options, line):
    env = FormationEnv("triangle", IDEAL, rewards=given, **options)
    env.reset()
    with pytest.raises(InputError, match=line):
        env.step({agent: np.zeros(env.action_space(agent).shape) for agent in env.agents})
