"""The controllers of a mission's units: what dies with a unit, and what does not."""

import numpy as np
import pytest

from skyherd.datasets import load_mission
from skyherd.sim.agents import UnitAgents, make_controller


@pytest.fixture
def made() -> list[int]:
    """Units for which a controller was made, in the order of making."""
    return []


@pytest.fixture
def agents(made) -> UnitAgents:
    def controller(mission, unit):
        made.append(unit)
        return make_controller(mission, unit)

    return UnitAgents(load_mission("star"), controller)


def test_a_unit_that_died_knows_nothing_and_is_made_anew_once(agents, made, make_detections) -> None:
    """However long it is dead: an outage of ten seconds is a hundred steps."""
    points = 200 + 100 * np.exp(2j * np.pi * np.arange(5) / 5)
    agents.decide(make_detections(range(5), points, unit_id=1), [])
    before, others = agents.controllers[1], [agents.controllers[unit] for unit in (0, 2)]
    assert agents.sets[1].size and made == [0, 1, 2]
    for _ in range(100):
        agents.lose(1)
    assert made == [0, 1, 2, 1]
    assert agents.controllers[1] is not before and not agents.sets[1].size
    assert [agents.controllers[unit] for unit in (0, 2)] == others


def test_a_unit_that_dies_again_is_made_anew_again(agents, made, make_detections) -> None:
    for _ in range(2):
        agents.decide(make_detections([0, 1], [100 + 100j, 300 + 100j], unit_id=1), [])
        agents.lose(1)
    assert made == [0, 1, 2, 1, 1]
