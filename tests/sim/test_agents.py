"""Controllers of a mission's units: the state lost with a unit, and the state that remains."""

import numpy as np
import pytest

from skyherd.datasets import load_mission
from skyherd.loop import run_steps
from skyherd.sim.agents import UnitAgents, make_controller
from skyherd.sim.robot_teams import make_avoidance


@pytest.fixture
def made() -> list[int]:
    """Return the units for which a controller was made, in the order of making."""
    return []


@pytest.fixture
def agents(made) -> UnitAgents:
    def controller(mission, unit):
        made.append(unit)
        return make_controller(mission, unit)

    return UnitAgents(load_mission("star"), controller)


@pytest.mark.smoke
def test_dead_unit_gets_one_new_controller_without_memory(agents, made, make_detections) -> None:
    """This holds for any duration of the outage: ten seconds are a hundred steps."""
    points = 200 + 100 * np.exp(2j * np.pi * np.arange(5) / 5)
    agents.decide(make_detections(range(5), points, unit_id=1), [])
    before, others = agents.controllers[1], [agents.controllers[unit] for unit in (0, 2)]
    assert agents.sets[1].size and made == [0, 1, 2]
    for _ in range(100):
        agents.lose(1)
    assert made == [0, 1, 2, 1]
    assert agents.controllers[1] is not before and not agents.sets[1].size
    assert [agents.controllers[unit] for unit in (0, 2)] == others


def test_unit_gets_a_new_controller_after_each_failure(agents, made, make_detections) -> None:
    for _ in range(2):
        agents.decide(make_detections([0, 1], [100 + 100j, 300 + 100j], unit_id=1), [])
        agents.lose(1)
    assert made == [0, 1, 2, 1, 1]


def test_robots_count_on_the_slowest_units_messages() -> None:
    """The ages are the maximum of latency plus image interval, and the minimum latency plus one interval."""
    settings = ["units.0.latency_s=0.3", "units.1.frame_rate_hz=2.0", "units.2.latency_s=0.1"]
    rule = make_avoidance(load_mission("star", settings).scenario)
    assert rule.nominal_age_s == pytest.approx(max(0.3 + 0.1, 0.0 + 0.5, 0.1 + 0.1))
    assert rule.superseded_age_s == pytest.approx(0.0 + 0.1)


def test_the_radio_of_a_dead_unit_forgets() -> None:
    """Units 0 and 1 die; unit 0 returns, without the earlier reports of unit 1.

    Only the loop clears the reports of the radio: the unit's controller is a new one in any case.
    """
    received: dict[float, list[tuple[int, float]]] = {}

    def controller(mission, unit):
        made = make_controller(mission, unit)
        if unit == 0:
            step = made.step

            def noted(detections, reports):
                received[detections.time_s] = [(report.unit_id, report.time_s) for report in reports]
                return step(detections, reports)

            made.step = noted
        return made

    settings = ["duration_s=1.2", "units.0.outages=[[0.6, 1.0]]", "units.1.outages=[[0.4, 5.0]]"]
    mission = load_mission("star", ["perception=ideal", *settings])
    for _ in run_steps(mission, controller_for=controller):
        pass
    times_s = sorted(received)
    before, after = received[times_s[5]], received[next(t for t in times_s if t > 0.95)]
    assert {unit for unit, _ in before} == {1, 2}
    assert {unit for unit, _ in after} == {2}
