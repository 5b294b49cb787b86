"""The actions of the built-in law, fed back, give the run of the scenario."""

import numpy as np
import pytest

from skyherd.analysis.history import make_history
from skyherd.analysis.summary import summarize
from skyherd.datasets import load_mission
from skyherd.environments import FormationEnv
from skyherd.loop import run_steps

STAR = {
    "duration_s": 2.0,
    "perception": "noisy",
    "units.*.frame_rate_hz": 5.0,
    "robots.body_radius_sides": 0.8,
    "avoidance.on": True,
}
LATE = {**STAR, "control.latency_compensation": True, "units.*.latency_s": 0.3, "network.message_loss": 0.1}
CLOCKS = {**STAR, "robots.clock_offset_s": 20.0, "units.1.clock_offset_s": -7.0}
CROWD = {"duration_s": 30.0, "step_s": 0.2, "perception": "noisy", "units.*.frame_rate_hz": 2.5}
WALL = ("real_time_factor", "wall_s", "loop_steps_per_s", "frames_per_s")
"""Keys of a summary that depend on the speed of the machine."""

CASES = [
    pytest.param("star", STAR, id="bodies"),
    pytest.param("star", LATE, id="late"),
    pytest.param("star", CLOCKS, id="clocks"),
    pytest.param("star", {"duration_s": 0.3}, id="rendered"),
    pytest.param("crowd", CROWD, id="crowd", marks=pytest.mark.slow),
]


def followed(env, seed, disturbed=0.0):
    """Return the true states of an episode under the reference actions, and the steps."""
    _, infos = env.reset(seed=seed)
    states = [env.state()]
    while env.agents:
        _, _, _, _, infos = env.step(
            {agent: info["reference_action"] + disturbed for agent, info in infos.items()}
        )
        states.append(env.state())
    return np.array(states)


def truth(mission):
    """Return the states of a run of the loop in the form of `FormationEnv.state`, and its steps."""
    steps = list(run_steps(mission))
    rows = []
    for step in steps:
        fleet = step.fleet
        robots = [
            [x, y, np.cos(h), np.sin(h)]
            for (x, y), h in zip(step.positions_m, step.headings_rad, strict=True)
        ]
        yaws_rad = fleet.yaws_rad
        units = np.column_stack(
            [
                fleet.positions_m,
                fleet.heights_m,
                np.cos(yaws_rad),
                np.sin(yaws_rad),
                fleet.tilts_rad,
                fleet.zooms,
            ]
        )
        share = step.time_s / mission.scenario.duration_s
        rows.append([share, *np.ravel(robots), *np.ravel(units)])
    return np.array(rows, np.float32), steps


@pytest.mark.parametrize(("name", "settings"), CASES)
@pytest.mark.parametrize("actions", ["wheels", "flight"])
def test_reference_actions_give_the_run_of_the_scenario(name, settings, actions):
    env = FormationEnv(name, settings, actions=actions, scaled=False, keep_steps=True)
    states, (expected, steps) = followed(env, 6), truth(load_mission(name, settings, seed=6))
    assert states.tobytes() == expected.tobytes()
    summary = summarize(make_history(load_mission(name, settings, seed=6), steps), 1.0)
    given = env.summary()
    assert given["complete"]
    assert [key for key in summary if str(given[key]) != str(summary[key])] == list(WALL)
    ways_m = np.linalg.norm(steps[-1].positions_m - steps[0].positions_m, axis=1)
    assert ways_m.max() > 0.1, "the robots drive"


@pytest.mark.parametrize("actions", ["wheels", "flight"])
def test_scaled_reference_actions_differ_by_rounding_alone(actions):
    settings = {"perception": "ideal", "duration_s": 6.0}  # Later, a choice of the unit amplifies rounding.
    exact = truth(load_mission("triangle", settings, seed=6))[0]
    scaled = followed(FormationEnv("triangle", settings, actions=actions), 6)
    # Actions in float32 have a relative error of 6e-8, in paths of at most 20 m. States are float32, too.
    np.testing.assert_allclose(scaled, exact, atol=1e-5)
    disturbed = followed(FormationEnv("triangle", settings, actions=actions), 6, disturbed=0.01)
    assert np.abs(disturbed - exact).max() > 1e-2
