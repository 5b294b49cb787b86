"""Messages that are late, overtaken, repeated and out of range."""

from dataclasses import replace

import numpy as np
import pytest

from skyherd.analysis.radio_check import foresee_radio
from skyherd.cli.run import _warn_of_the_radio
from skyherd.datasets import NetworkModel
from skyherd.datasets.configuration.mission import make_mission
from skyherd.datasets.generated.random_missions import Crowd, random_mission
from skyherd.loop import run_steps
from skyherd.messages import NO_ID
from skyherd.sim.network import Network, connected_parts
from skyherd.sim.physics import make_network


@pytest.fixture
def send_many(make_goals, make_report):
    """Send 400 messages of unit 0, at time 0, through a network of three units."""

    def send(parameters: NetworkModel, seed: int = 1) -> Network:
        network = Network(parameters, np.random.default_rng(seed), 3)
        for _ in range(400):
            network.send([make_goals(0, [0], [1])], make_report(0, [0], [0], [0]), 1.0)
        return network

    return send


def test_delays_are_spread_evenly_over_their_range(send_many) -> None:
    """Goals that arrived within a part of the range: 400 draws, 5 standard deviations of a binomial."""
    network = send_many(NetworkModel(delay_s=0.8))
    assert network.deliver(0.99) == []
    for share in (0.25, 0.75):
        network = send_many(NetworkModel(delay_s=0.8))
        arrived = len(network.deliver(1.0 + 0.8 * share))
        assert arrived / 400 == pytest.approx(share, abs=5 * np.sqrt(share * (1 - share) / 400))
        assert arrived + len(network.deliver(1.8)) == 400, "late, and none lost"


def test_each_receiver_has_a_delay_of_its_own(make_report) -> None:
    """Each receiver is the first for half of 400 reports, to 5 standard deviations of a binomial."""
    first = np.zeros(2)
    for seed in range(400):
        network = Network(NetworkModel(delay_s=1.0), np.random.default_rng(seed), 3)
        network.send([], make_report(0, [0], [0], [0]), 0.0)
        for time_s in np.arange(0.0, 1.01, 0.01):
            network.deliver(time_s)
            if network.reports[1] or network.reports[2]:
                break
        first += [bool(network.reports[1]), bool(network.reports[2])]
    assert first / 400 == pytest.approx(0.5, abs=5 * np.sqrt(0.25 / 400) + 0.01)


def test_repeats_are_of_the_stated_share_and_the_same_message(send_many) -> None:
    network = send_many(NetworkModel(repeats=0.3))
    delivered = [delivery.message for delivery in network.deliver(1.0)]
    assert (len(delivered) - 400) / 400 == pytest.approx(0.3, abs=5 * np.sqrt(0.21 / 400))
    assert len({id(goals) for goals in delivered}) == 400


def test_a_report_that_was_overtaken_changes_nothing(make_report) -> None:
    network = Network(NetworkModel(), np.random.default_rng(0), 2)
    report = make_report(0, [0], [0], [0])
    network.send([], replace(report, time_s=5.0), 1.0)
    network.send([], replace(report, time_s=4.0), 1.5)
    network.deliver(1.0)
    network.deliver(2.0)
    assert network.reports[1][0].time_s == 5.0


def test_the_dead_forget(make_report) -> None:
    network = Network(NetworkModel(), np.random.default_rng(0), 2)
    network.send([], make_report(0, [0], [0], [0]), 0.0)
    network.deliver(0.0)
    network.forget(1)
    assert network.reports == [{}, {}]


CHAIN = [[0, 1], [0, 1, 2], [1, 2, 3], [2, 3]]
"""Four units in a row, each in range of its neighbours."""


def test_relayed_reports_arrive_one_delay_later_per_hop(make_report) -> None:
    network = Network(NetworkModel(relay_s=0.25), np.random.default_rng(0), 4)
    network.connect(CHAIN)
    network.send([], make_report(0, [0], [0], [0]), 1.0)
    for time_s, heard in ((0.9, []), (1.0, [1]), (1.2, [1]), (1.25, [1, 2]), (1.5, [1, 2, 3])):
        network.deliver(time_s)
        assert [unit for unit in range(4) if network.reports[unit]] == heard
    network = Network(NetworkModel(relay=False), np.random.default_rng(0), 4)
    network.connect(CHAIN)
    network.send([], make_report(0, [0], [0], [0]), 1.0)
    network.deliver(9.0)
    assert network.reports == [{}, network.reports[1], {}, {}], "without relays it ends at the neighbour"


def test_network_drops_relayed_reports_of_dead_units(make_report) -> None:
    network = Network(NetworkModel(relay_s=0.1), np.random.default_rng(0), 4)
    network.connect(CHAIN, dead=[1])
    network.send([], make_report(0, [0], [0], [0]), 0.0)
    network.deliver(9.0)
    assert not any(network.reports)
    network.connect(CHAIN)
    network.send([], make_report(0, [0], [0], [0]), 10.0)
    network.connect(CHAIN, dead=[1])
    network.deliver(19.0)
    assert not network.reports[2], "what was under way to a unit that died ends there"
    network.forget(1)
    network.connect([[0, 1, 2, 3]] * 4)
    network.send([], make_report(0, [0], [0], [0]), 20.0)
    network.deliver(21.0)
    assert [list(heard) for heard in network.reports] == [[], [0], [0], [0]]
    assert not network._waiting, "what is no news to anybody is not passed on for ever"


def test_relay_repeats_lost_reports_with_its_next_report(make_report) -> None:
    """Half of all messages are lost: with 40 reports of unit 1, unit 2 receives the report of unit 0."""
    heard = 0
    for seed in range(50):
        network = Network(NetworkModel(message_loss=0.5, relay_s=0.01), np.random.default_rng(seed), 3)
        network.connect([[0, 1], [0, 1, 2], [1, 2]])
        network.reports[1][0] = make_report(0, [0], [0], [0])
        for tick in range(40):
            network.send([], replace(make_report(1, [0], [0], [0]), time_s=float(tick)), float(tick))
            network.deliver(float(tick))
        heard += 0 in network.reports[2]
    assert heard == 50


def test_parts_of_a_team_that_hear_of_each_other() -> None:
    assert connected_parts(CHAIN) == [[0, 1, 2, 3]]
    assert connected_parts([[0, 2], [1], [0, 2], [3, 4], [3, 4]]) == [[0, 2], [1], [3, 4]]


@pytest.mark.parametrize(
    ("network", "warning"),
    [
        ({"range_m": 3.0}, "units 0 | 1 cannot reach each other at the start (network.range_m = 3)"),
        ({"range_m": 30.0}, ""),
        ({"range_m": 30.0, "relay": False}, ""),
        ({}, ""),
    ],
)
def test_mission_warns_of_units_that_radio_does_not_connect(capsys, network, warning) -> None:
    tree = random_mission(3, Crowd(2, 5)) | {"network": network}
    _warn_of_the_radio(make_mission(tree))
    assert warning in capsys.readouterr().err.replace("\n", " ")
    if not warning:
        assert not capsys.readouterr().err


def test_a_mission_without_relays_is_told_what_comes_of_it(capsys) -> None:
    tree = random_mission(3, Crowd(5, 4, "chain")) | {"network": {"range_m": 9.0, "relay": False}}
    _warn_of_the_radio(make_mission(tree))
    assert "network.relay is false" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("kinds", "unit_1_m", "warnings"),
    [
        (("keep-in-view", "keep-in-view", "hover"), (0.0, 0.0), []),
        (
            ("keep-in-view", "follow", "perimeter"),
            (0.0, 0.0),
            ["units 1, 2 may fly out of network.range_m; only flight.kind"],
        ),
        (("keep-in-view", "keep-in-view", "hover"), (90.0, 0.0), ["units 0 and 1 may lose their radio link"]),
        (("hover", "hover", "hover"), (90.0, 0.0), []),
    ],
)
def test_mission_warns_of_radio_links_that_flight_may_break(kinds, unit_1_m, warnings) -> None:
    """Three units of a crowd; from 90 m away unit 1 sees no robot."""
    tree = random_mission(3, Crowd(3, 5)) | {"network": {"range_m": 120.0}}
    for unit, kind in zip(tree["units"], kinds, strict=True):
        unit |= {"position_m": (0.0, 0.0), "height_m": 15.0, "flight": {"kind": kind}}
    tree["units"][1]["position_m"] = unit_1_m
    tree["units"][2]["position_m"] = (-1.0, -1.0)
    found = foresee_radio(make_mission(tree))
    assert len(found) == len(warnings)
    assert all(text.startswith(start) for text, start in zip(found, warnings, strict=True))


def test_units_out_of_range_do_not_hear_one_another() -> None:
    """Two units 6 to 8 m apart: with a range below that each founds its own tree, above it one joins."""
    trees = {}
    for range_m in (3.0, 30.0):
        tree = random_mission(3, Crowd(2, 5)) | {"perception": "ideal", "duration_s": 8.0}
        for step in run_steps(make_mission(tree | {"network": {"range_m": range_m}})):
            words = [frame.decision.report.tree for frame in step.frames.values()]
        trees[range_m] = [word.tree_id for word in words]
    assert trees == {3.0: [0, 1], 30.0: [0, 0]}


@pytest.mark.smoke
def test_every_key_of_a_scenario_reaches_the_network(scenario_tree) -> None:
    faults = {"message_loss": 0.1, "delay_s": 0.2, "repeats": 0.3, "relay_s": 0.05}
    scenario = make_mission(scenario_tree("star") | {"network": faults}).scenario
    network = make_network(scenario, np.random.default_rng(0))
    assert network.model == NetworkModel(**faults)
    assert network.units == len(network.reports) == len(scenario.units)


@pytest.mark.parametrize(("outages", "founders"), [([], 1), ([[0.0, 100.0]], 2)])
def test_a_dead_unit_in_the_middle_is_no_relay(outages, founders) -> None:
    """Three units in a row, the outer ones in range only of the middle one: each of them founds a tree."""
    tree = random_mission(3, Crowd(3, 5, "chain")) | {"perception": "ideal", "duration_s": 8.0}
    places_m = [(-8.0, 0.0), (0.0, 0.0), (8.0, 0.0)]
    for unit, place_m in zip(tree["units"], places_m, strict=True):
        unit |= {"position_m": place_m, "flight": {"kind": "hover"}}
    tree["units"][1]["outages"] = outages
    for step in run_steps(make_mission(tree | {"network": {"range_m": 9.0}})):
        words = {unit: frame.decision.report.tree for unit, frame in step.frames.items()}
    assert len({word.tree_id for word in words.values()} - {NO_ID}) == founders
