"""Markers with unknown or repeated ids are bodies without identity, which robots avoid."""

from dataclasses import replace

import numpy as np
import pytest

from skyherd.control import AerialController, BodyRule, Hover, NeighborMemory, SafetyRadius, Template
from skyherd.control.avoidance.proximity import proximity
from skyherd.control.identities import AMBIGUOUS_S, AmbiguousIds
from skyherd.messages import ANONYMOUS_ID, BORDER_IDS, Proximity

TEAM = np.array([0, 1, 2])
RULE = BodyRule(1.0, margin_sides=0.5, horizon_sides=4.0, obstacles={40: 0.25})
ROBOT_1 = BORDER_IDS.size + 1
"""Column of robot 1 in a memory of the team."""


def pairs_of(message: Proximity, robot: int) -> list[tuple[int, float, float]]:
    """Return (other id, distance, share) of the pairs of a robot, sorted."""
    mine = message.robot_ids == robot
    columns = (message.other_ids, message.distances_sides.round(9), message.shares)
    return sorted(zip(*(column[mine].tolist() for column in columns), strict=True))


class TestProximity:
    def test_unknown_id_is_an_anonymous_body(self, make_detections) -> None:
        """It has a robot's radius, and may use half of the gap."""
        message = proximity(make_detections([0, 77], [0, 60]), TEAM, RULE)
        assert pairs_of(message, 0) == [(ANONYMOUS_ID, 3.0, 0.5)]
        assert message.reaches_sides.tolist() == [2.5] and message.ids.tolist() == [0]
        assert message.robot_ids.tolist() == [0], "an unknown body is no receiver"

    def test_repeated_id_is_a_body_at_each_place(self, make_detections) -> None:
        message = proximity(make_detections([0, 1, 1], [0, 60, 80j]), TEAM, RULE)
        assert pairs_of(message, 0) == [(ANONYMOUS_ID, 3.0, 0.5), (ANONYMOUS_ID, 4.0, 0.5)]
        assert message.ids.tolist() == [0, 1]

    def test_robot_of_repeated_id_gets_pairs_of_each_place(self, make_detections) -> None:
        """The places of robot 1 are 5 sides apart; robot 0 is 3 sides from one, 40 is 1 from the other."""
        message = proximity(make_detections([0, 1, 1, 40], [0, 60, 80j, 100j]), TEAM, RULE)
        expected = [(ANONYMOUS_ID, d, s) for d, s in ((1.0, 1.0), (3.0, 0.5), (4.0, 0.5), (5.0, 0.5))]
        got = [pair for pair in pairs_of(message, 1) if pair[1] < 5.5]
        assert sorted(set(got)) == sorted(expected)
        assert pairs_of(message, 0)[-1] == (40, 5.0, 1.0), "identified bodies keep their ids"

    def test_id_repeated_before_is_anonymous(self, make_detections) -> None:
        seen = make_detections([0, 1], [0, 60])
        assert pairs_of(proximity(seen, TEAM, RULE, ambiguous={1}), 0) == [(ANONYMOUS_ID, 3.0, 0.5)]
        assert pairs_of(proximity(seen, TEAM, RULE), 0) == [(1, 3.0, 0.5)]


class Listener:
    """Memory of robot 0, which receives messages about images of other robots and bodies."""

    def __init__(self, make_detections, speed_sides_ps: float = 1.0) -> None:
        self.memory = NeighborMemory(TEAM[:1], TEAM, 2.0, max_speed_sides_ps=speed_sides_ps)
        self.make_detections = make_detections

    def hear(self, time_s: float, others: dict[int, complex], unit_id: int = 0) -> None:
        """Receive the message on an image of robot 0 at the origin and others, in marker sides."""
        points = 20 * np.array([0, *others.values()])
        seen = self.make_detections([0, *others], points, time_s=time_s, unit_id=unit_id)
        self.memory.receive(proximity(seen, TEAM, RULE))

    def known(self, time_s: float) -> list[tuple[int, float]]:
        """Return (id, distance) of the bodies that are not stale."""
        rows, columns = self.memory.fresh(time_s)
        ids = self.memory.other_ids[columns].tolist()
        distances = self.memory.distances_sides[rows, columns].round(6).tolist()
        return sorted(zip(ids, distances, strict=True))


class TestMemory:
    def test_anonymous_body_follows_its_reports(self, make_detections) -> None:
        listener = Listener(make_detections)
        for tick in range(20):
            listener.hear(0.2 * tick, {77: 3.0 + 0.02 * tick, 78: 4.0j}, unit_id=tick % 2)
        assert listener.known(3.8) == [(ANONYMOUS_ID, 3.38), (ANONYMOUS_ID, 4.0)]
        assert listener.memory.other_ids.size == BORDER_IDS.size + TEAM.size + 2

    def test_missed_anonymous_body_stays_until_stale(self, make_detections) -> None:
        listener = Listener(make_detections)
        listener.hear(0.0, {77: 3.0})
        listener.hear(1.9, {})
        assert listener.known(1.9) == [(ANONYMOUS_ID, 3.0)]
        assert listener.known(2.1) == []

    def test_older_message_keeps_newer_anonymous_body(self, make_detections) -> None:
        listener = Listener(make_detections)
        listener.hear(1.0, {77: 3.0})
        listener.hear(0.9, {77: 3.1})
        assert (ANONYMOUS_ID, 3.0) in listener.known(1.0)

    def test_column_of_stale_body_is_used_again(self, make_detections) -> None:
        listener = Listener(make_detections)
        for tick in range(6):
            listener.hear(3.0 * tick, {77: 3.0 * 1j**tick})
        assert listener.memory.other_ids.size == BORDER_IDS.size + TEAM.size + 1

    def test_contradicting_place_of_an_id_is_kept(self, make_detections) -> None:
        """Two units see different markers of one id: the memory keeps both places."""
        listener = Listener(make_detections)
        for tick in range(10):
            listener.hear(0.1 * tick, {1: (3.0, 5.0j)[tick % 2]}, unit_id=tick % 2)
        assert listener.known(0.9) == [(ANONYMOUS_ID, 3.0), (1, 5.0)]

    def test_omitted_near_body_is_kept_as_anonymous(self, make_detections) -> None:
        """One unit reports robot 1 at 3 sides, and 0.1 s later the other one far beyond the horizon."""
        listener = Listener(make_detections)
        listener.hear(0.0, {1: 3.0})
        listener.hear(0.1, {1: 30.0}, unit_id=1)
        assert listener.known(0.1) == [(ANONYMOUS_ID, 3.0)]

    @pytest.mark.parametrize("side", BORDER_IDS.tolist())
    def test_side_of_an_image_that_moved_leaves_no_body(self, make_detections, side) -> None:
        """A camera that pans takes the sides of its image along; they are no bodies."""
        listener = Listener(make_detections)
        seen = proximity(make_detections([0], [0j]), TEAM, RULE)
        near = {
            "robot_ids": np.array([0]),
            "other_ids": np.array([side]),
            "distances_sides": np.array([3.0]),
            "bearings_rad": np.zeros(1),
            "reaches_sides": np.ones(1),
            "shares": np.ones(1),
            "ways_sides": np.zeros(1),
        }
        listener.memory.receive(replace(seen, **near))
        assert listener.known(0.0) == [(side, 3.0)]
        listener.memory.receive(replace(seen, time_s=0.1))
        assert listener.known(0.1) == []

    @pytest.mark.parametrize("speed", [1.0, np.inf])
    def test_reachable_place_replaces_earlier_one(self, make_detections, speed) -> None:
        """2.4 sides in 0.4 s are within 1 side, a fifth of the distance, and two robots at full speed."""
        listener = Listener(make_detections, speed)
        listener.hear(0.0, {1: 3.0})
        listener.hear(0.4, {1: 5.3})
        assert listener.known(0.4) == [(1, 5.3)]

    def test_unknown_speed_keeps_no_contradictions(self, make_detections) -> None:
        listener = Listener(make_detections, np.inf)
        listener.hear(0.0, {1: 3.0})
        listener.hear(0.1, {1: -3.0})
        assert listener.known(0.1) == [(1, 3.0)] and listener.memory.imaged_s.shape[1] == 7


class TestController:
    @pytest.fixture
    def unit(self) -> AerialController:
        template = Template(TEAM, np.array([0, 100, 100j]))
        return AerialController(template, SafetyRadius(radius=1.5), Hover(), bodies=RULE)

    def test_ambiguous_robot_gets_no_goal_but_is_avoided(self, make_detections, unit) -> None:
        seen = make_detections([0, 1, 2, 1], [100, 160, 100 + 60j, 100 + 120j])
        decision = unit.step(seen)
        assert decision.goals.ids.tolist() == decision.report.ids.tolist() == [0, 2]
        assert pairs_of(decision.proximity, 0)[0] == (ANONYMOUS_ID, 3.0, 0.5)
        assert 1 in decision.proximity.ids

    def test_missed_twin_leaves_the_id_ambiguous(self, make_detections, unit) -> None:
        """The robot is not detected in the second image, and the sheet alone must not become the robot."""
        unit.step(make_detections([0, 1, 2, 1], [100, 160, 100 + 60j, 100 + 120j]))
        for time_s, controlled in ((0.2, [0, 2]), (AMBIGUOUS_S + 0.1, [0, 1, 2])):
            decision = unit.step(make_detections([0, 1, 2], [100, 100 + 120j, 100 + 60j], time_s=time_s))
            assert decision.goals.ids.tolist() == controlled
            is_anonymous = decision.proximity.other_ids == ANONYMOUS_ID
            assert is_anonymous.any() == (1 not in controlled)

    def test_ambiguity_ends_after_its_time(self, make_detections) -> None:
        monitor = AmbiguousIds()
        twice, once = ([5, 5, 6], [1, 2, 3]), ([5, 6], [1, 3])
        assert monitor.update(make_detections(*twice)) == {5}
        assert monitor.update(make_detections(*once, time_s=AMBIGUOUS_S)) == {5}
        assert monitor.update(make_detections(*once, time_s=AMBIGUOUS_S + 0.01)) == frozenset()


@pytest.fixture(scope="module")
def benchmark(load_benchmark):
    """Return `benchmarks/odd_worlds.py` as a module."""
    return load_benchmark("odd_worlds")


@pytest.mark.parametrize("world", ["sheets", pytest.param("stranger", marks=pytest.mark.slow)])
def test_crowd_among_spare_markers_has_no_contact(benchmark, monkeypatch, world) -> None:
    monkeypatch.setitem(benchmark.DURATION_S, "sheets", 40.0)
    row = benchmark.run_world(118, world)
    assert row["contacts"] == 0 and row["min_gap_sides"] > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("apart", [True, False])
@pytest.mark.parametrize("world", ["sheet", "sheets"])
def test_crowd_among_copies_forms_if_robots_are_told_apart(benchmark, world, apart) -> None:
    """Seed 703: without it the robots with copies stand."""
    row = benchmark.run_world(703, world, apart=apart)
    assert row["contacts"] == 0 and (row["shape_error"] < 0.02) == apart


@pytest.mark.slow
def test_crowd_without_anonymous_bodies_has_contact(benchmark, monkeypatch) -> None:
    """Negative control: units omit ambiguous markers, and robots trust the newest message."""
    monkeypatch.setattr(NeighborMemory, "_keep_contradicted", lambda *_: None)
    monkeypatch.setattr("skyherd.control.aerial_controller.rectified", lambda seen, _: seen.unambiguous())
    assert benchmark.run_world(118, "sheets", apart=False)["contacts"] > 0
