"""Commands that the caller of the loop sends instead of those of a step."""

import numpy as np

from skyherd.datasets import load_mission
from skyherd.loop import Overruling, run_steps
from skyherd.messages import FlightCommand, VelocityCommand
from skyherd.sim.world import move_unicycles

SETTINGS = {"perception": "ideal", "duration_s": 2.0}


def sent(mission, overruling_of):
    """Return the steps of a run whose commands are overruled by a function of the step."""
    run = run_steps(mission)
    steps = [next(run)]
    try:
        while True:
            steps.append(run.send(overruling_of(steps[-1])))
    except StopIteration:
        return steps


def poses(steps):
    return np.array([[*step.positions_m.ravel(), *step.headings_rad] for step in steps])


def flown(steps):
    return np.array([[*step.fleet.positions_m.ravel(), *step.fleet.heights_m] for step in steps])


def test_own_commands_sent_give_the_same_run():
    mission = load_mission("triangle", SETTINGS)
    plain = list(run_steps(mission))
    same = sent(
        mission, lambda s: Overruling(s.command, [frame.decision.flight for frame in s.frames.values()])
    )
    assert poses(same).tobytes() == poses(plain).tobytes()
    assert flown(same).tobytes() == flown(plain).tobytes()


def test_sent_wheels_move_robots_along_their_arcs():
    mission = load_mission("triangle", SETTINGS)
    ids, limits = mission.ids, mission.scenario.robots
    command = VelocityCommand(ids, np.linspace(-0.4, 0.5, ids.size), np.linspace(1.0, -2.0, ids.size))
    steps = sent(mission, lambda step: Overruling(command))
    end = move_unicycles(
        mission.positions_m, mission.headings_rad, command.v_mps, command.omega_radps, steps[-1].time_s
    )
    # One arc of 2 s or 20 arcs of 0.1 s: rounding of sums of at most 10 m.
    np.testing.assert_allclose(steps[-1].positions_m, end[0], atol=1e-12)
    fast = VelocityCommand(ids, np.full(ids.size, 50.0), np.zeros(ids.size))
    ways = np.linalg.norm(
        np.diff([s.positions_m for s in sent(mission, lambda s: Overruling(fast))], axis=0), axis=2
    )
    np.testing.assert_allclose(ways, limits.max_speed_mps * mission.scenario.step_s, rtol=1e-12)


def test_sent_flights_move_living_units_alone():
    outage = {"units.1.outages": [[0.55, 1.55]]}
    mission = load_mission("star", {**SETTINGS, **outage})
    climbs = [FlightCommand(unit, np.zeros(2), climb_mps=0.5, yaw_rate_radps=0.0) for unit in range(3)]
    heights_m = np.array(
        [step.fleet.heights_m for step in sent(mission, lambda step: Overruling(flights=climbs))]
    )
    climbed = np.diff(heights_m, axis=0)
    np.testing.assert_allclose(climbed[:, [0, 2]], 0.05, atol=1e-12)
    dead = (np.arange(20) >= 6) & (np.arange(20) < 16)
    np.testing.assert_allclose(climbed[:, 1], np.where(dead, 0.0, 0.05), atol=1e-12)
