"""One edge of the tree: turns alternate under any fate of the reports that hand them over."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyherd.control.tree.edge import NO_ROBOTS, NO_TURN, Edge, edge_status, first_turn, has_turn
from skyherd.messages import NO_ID, TreeStatus, UnitReport

NONE = np.array([], dtype=np.int64)


def report_of(edge: Edge, time_s: float = 0.0) -> UnitReport:
    """Return the report of the unit at this end, with this edge alone."""
    offered, to_release = sorted(edge.offered), sorted(edge.releasing & edge.offered)
    status = TreeStatus(
        tree_id=0,
        asks_id=NO_ID,
        ask_turn=NO_TURN,
        heir_id=NO_ID,
        ready=True,
        neighbor_ids=np.array([edge.neighbor_id]),
        turns=np.array([edge.turn]),
        pairs=np.array([sorted(edge.pair) or [NO_ID, NO_ID]]),
        offered_ids=np.array(offered, dtype=np.int64),
        offered_to_ids=np.full(len(offered), edge.neighbor_id),
        to_release_ids=np.array(to_release, dtype=np.int64),
        missing_ids=NONE,
        handed_ids=NONE,
        handed_to_ids=NONE,
        handed_slots=NONE,
        accepted_ids=NONE,
    )
    return UnitReport(edge.unit_id, time_s, np.array([800, 800]), NONE, np.zeros((0, 2)), NONE, NONE, status)


def ends() -> tuple[Edge, Edge]:
    pair = frozenset({1, 2})
    return Edge(3, 7, 0.0, 0, pair), Edge(7, 3, 0.0, 0, pair)


def test_each_turn_belongs_to_exactly_one_end() -> None:
    for turn in range(20):
        assert has_turn(turn, 3, 7) != has_turn(turn, 7, 3)
        assert has_turn(turn, 3, 7) == (turn % 2 == 0), "the lower unit has_turn the even ones"


@pytest.mark.parametrize("holder", [3, 7])
def test_new_edge_starts_beyond_turns_of_former_edge(holder) -> None:
    """A turn per image, at 500 images a second: after 60 s the old edge is behind the start of a new one."""
    other = 10 - holder
    start = first_turn(1.0, holder, other)
    assert has_turn(start, holder, other) and not has_turn(start, other, holder)
    assert first_turn(61.0, other, holder) > start + 500 * 60


@pytest.mark.parametrize("time_ms", [0, 1, 2, 3, 1000, 1001])
def test_first_turn_belongs_to_opener_and_follows_clock(time_ms) -> None:
    for holder, other in ((3, 7), (7, 3)):
        start = first_turn(time_ms / 1000, holder, other)
        assert has_turn(start, holder, other) and start in (time_ms, time_ms + 1)


def test_received_turn_contains_pair_and_offers() -> None:
    one, two = ends()
    assert one.is_my_turn and not two.is_my_turn
    one = replace(one, pair=frozenset({1, 5}))
    one = one.handed_over(offered=frozenset({8, 9}), releasing=frozenset({9, 4}))
    assert not one.is_my_turn and not two.is_my_turn, "in transit no end has it"
    two = two.received(report_of(one))
    assert two.is_my_turn and (two.turn, two.pair) == (1, {1, 5})
    assert two.reach == {8, 9} and two.to_release == {9}, "only what is offered can be released"
    assert one.offered == {8, 9} and not two.offered, "promised until the turn is back"
    two = two.handed_over(offered=frozenset({6}), releasing=NO_ROBOTS)
    one = one.received(report_of(two))
    assert one.is_my_turn and one.reach == {6} and not one.offered and not two.reach


def test_repeated_and_stale_reports_change_nothing() -> None:
    one, two = ends()
    one = one.handed_over(frozenset({8}), NO_ROBOTS)
    old = report_of(one)
    two = two.received(old)
    two = replace(two, pair=frozenset({2, 8}))
    two = two.received(old)
    assert two.pair == {2, 8}, "the turn that it has is not taken again"
    two = two.handed_over(NO_ROBOTS, NO_ROBOTS)
    two = two.received(old)
    assert two.turn == 2 and two.pair == {2, 8}
    one = one.received(report_of(two))
    one = one.handed_over(NO_ROBOTS, NO_ROBOTS)
    one = one.received(report_of(two))
    assert one.turn == 3, "nor a report of a turn that has passed"


def test_end_without_turn_accepts_first_report() -> None:
    heir = Edge(7, 3, 0.0, pair=frozenset({1, 2}))
    assert heir.turn == NO_TURN and not heir.is_my_turn
    other = Edge(3, 7, 0.0, 51, frozenset({4, 5}))
    heir = heir.received(report_of(other))
    assert (heir.turn, heir.pair, heir.is_my_turn) == (51, {4, 5}, True)


@pytest.mark.parametrize("turn", [4, 5])
def test_abandoned_end_changes_to_new_edge(turn) -> None:
    """Unit 3 declared unit 7 dead and then found it again, as the heir of another one: two edges of one name.

    Without the rule unit 7 waits forever for the next turn of the first edge, whether its own or not.
    """
    old = Edge(7, 3, 0.0, turn, frozenset({1, 2}), offered=frozenset({8}))
    new = Edge(3, 7, 32.0, first_turn(32.0, 3, 7), frozenset({4, 5}))
    old = old.received(report_of(new))
    assert (old.turn, old.pair, old.is_my_turn) == (new.turn, {4, 5}, False) and not old.offered
    new = new.handed_over(frozenset({6}), NO_ROBOTS)
    old = old.received(report_of(new))
    assert old.is_my_turn and old.reach == {6}


def test_report_on_other_edges_changes_nothing() -> None:
    one, two = ends()
    assert edge_status(report_of(one), 8) is None
    before = (two.turn, two.pair)
    two = two.received(report_of(Edge(3, 8, 0.0, 1, frozenset({6, 7}))))
    assert (two.turn, two.pair) == before


@settings(max_examples=60)
@given(st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 200), st.booleans()), max_size=60))
def test_turns_of_both_ends_differ_by_at_most_one(story) -> None:
    """Each end reports at any time and receives any report in any order: one turn, one pair, one holder.

    `pair` represents the holder's change, a new number each time: ends at the same turn have the same.
    """
    edges = dict(zip("ab", ends(), strict=True))
    sent: dict[str, list[UnitReport]] = {name: [report_of(edge)] for name, edge in edges.items()}
    fresh = 10
    for name, pick, changes in story:
        reports = sent["b" if name == "a" else "a"]
        edge = edges[name].received(reports[pick % len(reports)])
        if edge.is_my_turn and changes:
            edge = replace(edge, pair=frozenset({fresh, fresh + 1})).handed_over(NO_ROBOTS, NO_ROBOTS)
            fresh += 2
        edges[name] = edge
        sent[name].append(report_of(edge))
        one, two = edges["a"], edges["b"]
        assert not (one.is_my_turn and two.is_my_turn)
        assert abs(one.turn - two.turn) <= 1
        assert one.turn != two.turn or one.pair == two.pair
