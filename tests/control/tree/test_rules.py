"""Single rules of the tree protocol, each in a context in which one of its conditions decides."""

from dataclasses import replace

import numpy as np
import pytest

from skyherd.control import BodyRule, RoleRule, Template, TreeSettings
from skyherd.control.tree.edge import NO_TURN, Edge
from skyherd.control.tree.failover import fail_over, name_heir, successor_of
from skyherd.control.tree.hand_over import give, take
from skyherd.control.tree.joining import admit
from skyherd.control.tree.node_state import HandOver, NodeState, Situation
from skyherd.control.tree.offers import offerable
from skyherd.control.tree.orphans import adopt_orphans
from skyherd.control.tree.pair_exchange import _to_release, receive_turns, use_turns
from skyherd.control.tree.partition import heal_partition, leave_for_lower_tree
from skyherd.control.tree.peer_reports import PeerReports
from skyherd.control.tree.protocol import note_view
from skyherd.control.tree.view_targets import seek_robots
from skyherd.datasets.configuration.models import AvoidanceModel, RolesModel, SelectionModel
from skyherd.messages import NO_ID, NO_SLOT, TreeStatus, UnitReport

SIZE_PX = np.array([800, 800])
SHAPE = Template(np.arange(8), np.exp(2j * np.pi * np.arange(8) / 8) * (1 + 0.1 * np.arange(8)))
RULE = TreeSettings(share="nearest")


def report(
    unit,
    time_s,
    *,
    controls=(),
    sees=None,
    tree_id=0,
    edges=(),
    heir=NO_ID,
    asks=NO_ID,
    handed=None,
    accepts=(),
):
    """Return a report: visible robots by distance in half images, edges as (neighbour, turn, pair)."""
    sees, handed = sees or {}, handed or {}
    points = np.array([(799 / 2 + 400 * at, 799 / 2) for at in sees.values()]).reshape(-1, 2)
    tree = TreeStatus(
        tree_id=tree_id,
        asks_id=asks,
        ask_turn=0,
        heir_id=heir,
        ready=True,
        neighbor_ids=[neighbor for neighbor, _, _ in edges],
        turns=[turn for _, turn, _ in edges],
        pairs=np.array([pair for _, _, pair in edges]).reshape(-1, 2),
        offered_ids=[],
        offered_to_ids=[],
        to_release_ids=[],
        missing_ids=[],
        handed_ids=list(handed),
        handed_to_ids=[to_id for to_id, _ in handed.values()],
        handed_slots=[slot for _, slot in handed.values()],
        accepted_ids=list(accepts),
    )
    return UnitReport(
        unit_id=unit,
        time_s=time_s,
        image_size_px=SIZE_PX,
        ids=list(sees),
        points_px=points,
        controlled_ids=list(controls),
        secure_ids=[],
        tree=tree,
    )


def situation(unit, reports, *, time_s=10.0, sees=None, at_slot=True):
    """Return the context of a unit at an image in slot 5, by default the first one."""
    peers = PeerReports()
    news = peers.take(reports)
    return Situation(
        settings=RULE,
        shape=SHAPE,
        unit_id=unit,
        time_s=time_s,
        slot=5,
        at_slot=at_slot,
        distances=sees or {},
        news=news,
        peers=peers,
    )


def robots(*ids):
    return frozenset(ids)


def out_of_view(*ids, **fields):
    """Return a member's state whose own robots, these ones, left its view at 5 s."""
    times = {"seen_s": dict.fromkeys(ids, 5.0), "held_s": dict.fromkeys(ids, 1.0)}
    return NodeState(own=robots(*ids), tree_id=0, **times, **fields)


def test_lost_robot_goes_to_nearest_member_inside_radius():
    reports = [report(7, 10.0, sees={1: 0.3, 2: 0.9}), report(9, 10.0, sees={1: 0.2, 3: 0.2})]
    changed = give(out_of_view(1, 2, 3), situation(0, reports))
    assert changed.giving == {1: HandOver(9), 3: HandOver(9)}
    assert changed.own == robots(1, 2, 3), "announced robots are still its own"


def test_promised_robot_is_not_handed_over():
    """Robots 1 and 2 left the view and unit 9 sees both; 1 is offered to unit 7."""
    edge = Edge(0, 7, 0.0, turn=1, pair=robots(3, 4), offered=robots(1))
    now = situation(0, [report(9, 10.0, sees={1: 0.1, 2: 0.1})])
    assert give(out_of_view(1, 2, edges={7: edge}), now).giving.keys() == {2}


def test_disputed_robot_is_not_handed_over():
    """Of robots 1 and 2, which unit 9 sees, unit 7 claims 1: that dispute must be settled first."""
    reports = [report(7, 10.0, controls=[1]), report(9, 10.0, sees={1: 0.1, 2: 0.1})]
    assert give(out_of_view(1, 2), situation(0, reports)).giving.keys() == {2}


def test_settled_hand_over_keeps_its_receiver():
    """Unit 7 sees the robot nearer by now, but unit 9 relies on it."""
    now = situation(0, [report(7, 10.0, sees={1: 0.1}), report(9, 10.0, sees={1: 0.3})])
    assert give(out_of_view(1, giving={1: HandOver(9, 6)}), now).giving == {1: HandOver(9, 6)}


def test_handed_over_robot_is_not_offered():
    now = situation(0, [report(9, 10.0, sees={1: 0.1, 2: 0.1})], sees={1: 0.1, 2: 0.1})
    state = NodeState(own=robots(1, 2), tree_id=0, giving={2: HandOver(9, 6)}, held_s={1: 1.0, 2: 1.0})
    assert offerable(state, now, 9) == robots(1)


@pytest.mark.parametrize(("time_s", "slot"), [(10.0, 6), (10.8, 6), (11.2, 7), (11.9, 7)])
def test_accepted_hand_over_is_settled_half_a_slot_ahead(time_s, slot):
    """Slots are of 2 s; the sixth begins at 12 s, the seventh at 14 s."""
    now = situation(0, [report(9, time_s, sees={1: 0.1}, accepts=[1])], time_s=time_s, at_slot=False)
    assert give(out_of_view(1, giving={1: HandOver(9)}), now).giving == {1: HandOver(9, slot)}


@pytest.mark.parametrize("at_slot", [True, False])
def test_unaccepted_hand_over_is_withdrawn(at_slot):
    """Unit 9 no longer sees the robot: at a slot the unit searches for another receiver, without success."""
    now = situation(0, [report(9, 10.0, sees={2: 0.1}, accepts=[2])], at_slot=at_slot)
    changed = give(out_of_view(1, giving={1: HandOver(9)}), now)
    assert changed.own == robots(1) and changed.giving == ({} if at_slot else {1: HandOver(9)})


@pytest.mark.parametrize(("slot", "own"), [(5, ()), (6, (1,)), (NO_SLOT, (1,))])
def test_settled_robot_is_dropped_exactly_in_its_slot(slot, own):
    """This holds even if the unit has seen it again meanwhile: the other one relies on it."""
    now = situation(0, [report(9, 10.0)], sees={1: 0.1}, at_slot=False)
    state = NodeState(own=robots(1), tree_id=0, giving={1: HandOver(9, slot)}, seen_s={1: 10.0})
    changed = give(state, now)
    assert changed.own == robots(*own)
    assert changed.giving == ({1: HandOver(9, 6)} if slot == 6 else {})


@pytest.mark.parametrize(
    ("handed", "sees", "accepted"),
    [
        pytest.param({5: (1, NO_SLOT)}, {5: 0.5}, (5,), id="in view"),
        pytest.param({5: (1, NO_SLOT)}, {5: 0.9}, (), id="outside the radius"),
        pytest.param({5: (2, NO_SLOT)}, {5: 0.5}, (), id="handed to another unit"),
        pytest.param({4: (1, NO_SLOT)}, {4: 0.5}, (), id="its own already"),
    ],
)
def test_visible_handed_robots_are_accepted(handed, sees, accepted):
    now = situation(1, [report(0, 10.0, controls=handed, handed=handed)], sees=sees)
    changed = take(NodeState(own=robots(4), tree_id=0), now)
    assert changed.accepted == robots(*accepted) and changed.own == robots(4)


@pytest.mark.parametrize(
    ("slot", "third", "own", "taking"),
    [
        pytest.param(6, (), (), {5: (0, 6)}, id="its slot is to come"),
        pytest.param(5, (), (5,), {}, id="its slot is this one"),
        pytest.param(4, (), (), {}, id="its slot is over"),
        pytest.param(5, (5,), (), {}, id="a third unit has it"),
    ],
)
def test_settled_robot_is_taken_in_its_slot(slot, third, own, taking):
    """This holds even if it is out of view by then: the former unit does not wait."""
    reports = [report(0, 9.9, controls=[5], handed={5: (1, slot)}), report(2, 9.9, controls=third)]
    changed = take(NodeState(tree_id=0), situation(1, reports))
    assert changed.own == robots(*own) and changed.taking == taking


def test_stale_report_does_not_repeat_hand_over():
    """The newest report of unit 0 is the one by which robot 5 was taken."""
    now = situation(1, [report(0, 9.9, controls=[5], handed={5: (1, 5)})])
    changed = take(NodeState(tree_id=0, accepted=robots(5)), replace(now, news=()))
    assert changed.own == robots() and not changed.taking


def test_withdrawn_hand_over_is_not_accepted():
    now = situation(1, [report(0, 10.0, controls=[5])], sees={5: 0.5})
    assert take(NodeState(tree_id=0, accepted=robots(5)), now).accepted == robots()


def test_unit_leaving_tree_clears_hand_overs():
    """A lower tree exists; none of the agreed robots is the unit's in the new one."""
    state = out_of_view(1, giving={1: HandOver(9, 6)}, taking={2: (9, 6)}, accepted=robots(3))
    state = leave_for_lower_tree(replace(state, tree_id=4), situation(5, []))
    assert state.is_member and state.giving
    state = leave_for_lower_tree(state, situation(5, [report(0, 10.0)]))
    assert not state.is_member and not (state.own or state.giving or state.taking or state.accepted)


@pytest.mark.parametrize(("unit", "adopts"), [(0, True), (2, False)])
def test_orphan_at_equal_distance_goes_to_lower_unit(unit, adopts):
    now = situation(unit, [report(1, 10.0, sees={5: 0.25})], sees={5: 0.25})
    state = NodeState(tree_id=0, orphaned_s={5: 0.0}, distances_before=dict(now.peers.newest[1].distances))
    assert (5 in adopt_orphans(state, now).own) == adopts


def test_orphan_goes_to_nearer_unit():
    for unit in (0, 2):
        now = situation(unit, [report(1, 10.0, sees={5: 0.25})], sees={5: 0.2})
        near = NodeState(tree_id=0, orphaned_s={5: 0.0}, distances_before={5: 0.2})
        far = NodeState(tree_id=0, orphaned_s={5: 0.0}, distances_before={5: 0.3})
        assert 5 in adopt_orphans(near, now).own and 5 not in adopt_orphans(far, now).own


def test_heir_inherits_unclaimed_robots():
    """Unit 1 is dead, unit 0 its heir; robot 4 was its as well, but unit 2 has it by now."""
    gone = report(1, 0.0, controls=[1, 2, 3, 4], edges=[(0, 4, [1, 2])], heir=0)
    now = situation(0, [gone, report(2, 10.0, controls=[4])])
    state = NodeState(own=robots(6), edges={1: Edge(0, 1, 0.0, turn=4, pair=robots(1, 2))}, tree_id=0)
    changed = fail_over(state, now)
    assert changed.own == robots(1, 2, 3, 6) and not changed.edges


def test_heir_opens_edges_of_dead_unit_to_living_units():
    gone = report(
        1, 0.0, controls=[1, 2, 3, 4], edges=[(0, 4, [1, 2]), (2, 8, [3, 4]), (3, 8, [5, 6])], heir=0
    )
    now = situation(0, [gone, report(2, 10.0, controls=[3, 4])])
    state = NodeState(edges={1: Edge(0, 1, 0.0, turn=4, pair=robots(1, 2))}, tree_id=0)
    edges = fail_over(state, now).edges
    assert edges.keys() == {2} and edges[2].pair == robots(3, 4)


@pytest.mark.parametrize(("since_s", "stays"), [(9.5, True), (0.0, False)])
def test_new_edge_survives_one_silence_timeout(since_s, stays):
    """A stale report of the neighbour is no evidence against an edge younger than a silence timeout."""
    old = report(1, 0.0, controls=[1, 2], edges=[(0, 4, [1, 2])], heir=0)
    state = NodeState(edges={1: Edge(0, 1, since_s, turn=4, pair=robots(1, 2))}, tree_id=0)
    assert (1 in fail_over(state, situation(0, [old])).edges) == stays


@pytest.mark.parametrize(("own", "granted"), [((1,), False), ((1, 2), True)])
def test_edge_is_granted_only_with_two_robots(own, granted):
    asks = report(5, 10.0, sees={1: 0.1, 2: 0.1}, tree_id=NO_ID, asks=0)
    state = NodeState(own=robots(*own), tree_id=0)
    now = replace(situation(0, [asks], sees={1: 0.1, 2: 0.1}), slot=0)
    assert (5 in admit(state, now).edges) == granted


def test_own_robots_do_not_enter_pair():
    """Robot 3 is offered by unit 1 and claimed by unit 0, since two units may adopt it at the same time.

    In the pair it would be shared and still unit 0's own: its edge to a third unit could contain it too.
    """
    sees = {1: 0.5, 2: 0.6, 3: 0.01, 4: 0.05}
    peer = report(1, 10.0, controls=[1, 2, 3, 4], sees=sees, edges=[(0, 4, [1, 2])])
    edge = Edge(0, 1, 0.0, turn=4, pair=robots(1, 2), reach=robots(3, 4))
    for own, pair in ((robots(3), robots(1, 4)), (robots(), robots(3, 4))):
        state = NodeState(own=own, edges={1: edge}, tree_id=0)
        assert use_turns(state, situation(0, [peer], sees=sees)).edges[1].pair == pair


def test_unit_without_change_hands_turn_over_at_once():
    """Between two slots, with the best pair already shared; another one in reach makes it wait."""
    for reach, turn in ((robots(), 5), (robots(3, 4), 4)):
        sees = {1: 0.1, 2: 0.2, 3: 0.01, 4: 0.05}
        peer = report(1, 10.0, controls=[1, 2, *reach], sees=sees, edges=[(0, 4, [1, 2])])
        edge = Edge(0, 1, 0.0, turn=4, pair=robots(1, 2), reach=reach)
        plain = TreeSettings(share="nearest", gain=1.0)
        now = replace(situation(0, [peer], sees=sees), at_slot=False, settings=plain)
        changed = use_turns(NodeState(edges={1: edge}, tree_id=0), now).edges[1]
        assert (changed.turn, changed.pair, changed.wants) == (turn, robots(1, 2), turn == 4)


def test_repeated_and_late_reports_are_no_news():
    peers = PeerReports()
    first, second = report(1, 9.0, controls=[1]), report(1, 10.0, controls=[2])
    assert [peer.report for peer in peers.take([first, second])] == [first, second]
    assert peers.take([second]) == () and peers.take([first]) == ()
    assert peers.newest[1].report is second
    later = report(1, 11.0, tree_id=NO_ID)
    assert len(peers.take([later, later])) == 1
    assert peers.newest[1].report is later and peers.last_as_member[1].report is second


@pytest.mark.parametrize(("tree_id", "leaves"), [(NO_ID, False), (2, True), (3, False), (4, False)])
def test_tree_with_lower_number_remains(tree_id, leaves):
    now = situation(5, [report(1, 10.0, tree_id=tree_id)])
    state = NodeState(tree_id=3)
    assert (leave_for_lower_tree(state, now) != state) == leaves


@pytest.mark.parametrize("since_s", [3.0, 10.0 - RULE.silence_s, 10.0 - RULE.silence_s + 0.1, 10.0])
def test_smaller_part_of_tree_resigns_after_silence_timeout(since_s):
    """Units 0 and 1 report an edge between them; unit 5 has none. It resigns exactly at the timeout."""
    others = [report(0, 10.0, edges=[(1, 4, [1, 2])]), report(1, 10.0, edges=[(0, 4, [1, 2])])]
    state = NodeState(tree_id=0, minority_s=since_s)
    changed = heal_partition(state, situation(5, others))
    if 10.0 - since_s >= RULE.silence_s:
        assert changed.tree_id == NO_ID and changed.minority_s == np.inf
    else:
        assert changed == state


def test_larger_part_of_tree_remains_with_ties_to_lowest_unit():
    alone = NodeState(tree_id=0, minority_s=0.0)
    for unit, stays in ((5, False), (0, True)):
        now = situation(unit, [report(3, 10.0)])
        assert heal_partition(alone, now).is_member == stays
    now = situation(5, [report(0, 10.0), report(6, 10.0, edges=[(5, 4, [1, 2])])])
    paired = replace(alone, edges={6: Edge(5, 6, 0.0, turn=4, pair=robots(1, 2))})
    assert heal_partition(paired, now) == replace(paired, minority_s=np.inf)


def test_unseen_time_of_robot():
    """The time counts from the last sighting; if never seen, from the first miss; otherwise it is zero."""
    state = NodeState(seen_s={1: 4.0}, missed_since_s={1: 1.0, 2: 7.0})
    assert [state.unseen_s(robot, 10.0) for robot in (1, 2, 3)] == [6.0, 3.0, 0.0]


def test_unchanged_state_is_identical_object():
    """Cached values of the old state, such as the controlled robots, are not copied to a changed one."""
    edge = Edge(1, 2, 0.0, pair=robots(4, 5))
    state = NodeState(own=robots(1), edges={2: edge}, held_s={1: 3.0})
    assert state.controlled == robots(1, 4, 5)
    assert state.after(state) is state
    assert state.after(replace(state, own=robots(1), edges={2: replace(edge)}, minority_s=np.inf)) is state
    for changes in ({"edges": {}}, {"own": robots(1, 2)}, {"held_s": {1: 4.0}}, {"ready": True}):
        new = replace(state, slot=-1, **changes)
        assert state.after(new) == new != state
    assert state.after(replace(state, edges={})).controlled == robots(1)


def test_controlled_or_claimed_robot_is_no_orphan():
    """Robots 1 and 2 are in a pair, 3 is the unit's own, 4 is another's: only 5 is uncontrolled."""
    edge = Edge(0, 7, 0.0, turn=1, pair=robots(1, 2))
    sees = dict.fromkeys(range(1, 6), 0.2)
    waited = dict.fromkeys(range(1, 6), 0.0)
    state = NodeState(own=robots(3), edges={7: edge}, tree_id=0, orphaned_s=waited, distances_before=sees)
    changed = adopt_orphans(state, situation(0, [report(9, 10.0, controls=[4])], sees=sees))
    assert changed.own == robots(3, 5) and changed.orphaned_s.keys() == {5}


def test_common_robots_are_offered_in_pairs_by_slot():
    """Slots alternate: robots 0 and 1 to unit 7 at even slots, 2 and 3 at odd ones."""
    sees = dict.fromkeys(range(4), 0.2)
    edges = {unit: Edge(0, unit, 0.0, turn=1, pair=robots(unit, unit + 10)) for unit in (7, 8)}
    state = NodeState(own=robots(*sees), edges=edges, tree_id=0, seen_s=dict.fromkeys(sees, 10.0))
    for slot in range(4):
        now = replace(situation(0, [report(unit, 10.0, sees=sees) for unit in (7, 8)], sees=sees), slot=slot)
        first, second = (robots(0, 1), robots(2, 3)) if slot % 2 == 0 else (robots(2, 3), robots(0, 1))
        assert (offerable(state, now, 7), offerable(state, now, 8)) == (first, second)


@pytest.mark.parametrize(
    ("pair", "heard", "heir"), [((1, 2), True, 7), ((), True, NO_ID), ((1, 2), False, NO_ID)]
)
def test_heir_needs_pair_and_report(pair, heard, heir):
    state = NodeState(edges={7: Edge(0, 7, 0.0, turn=1, pair=robots(*pair))}, tree_id=0)
    now = situation(0, [report(7, 10.0, controls=[1, 2])] if heard else [])
    assert name_heir(state, now).heir_id == heir


def test_settings_defaults_equal_scenario_defaults():
    """Lengths, times and shares have their defaults in two places, which must be equal."""
    tree, roles, bodies = SelectionModel(), RolesModel(), AvoidanceModel()
    for rule, model in ((TreeSettings(), tree), (RoleRule(), roles), (BodyRule(1.0), bodies)):
        both = vars(rule).keys() & type(model).model_fields.keys() - {"classes"}
        assert len(both) >= 2
        assert {name: getattr(rule, name) for name in both} == {name: getattr(model, name) for name in both}


@pytest.mark.parametrize(("free", "released"), [((5, 6), robots(2)), ((5,), robots())])
def test_leaving_robot_is_released_if_two_can_return(free, released):
    """Leaving begins at the radius with its hysteresis, 0.85 * 1.06 = 0.901: robot 1 is below it."""
    peer = report(1, 10.0, controls=free, sees=dict.fromkeys((1, 2, 5, 6), 0.1))
    now = situation(0, [peer], sees={1: 0.89, 2: 0.91, 5: 0.5, 6: 0.5})
    edge = Edge(0, 1, 0.0, turn=4, pair=robots(3, 4))
    assert _to_release(now, edge, robots(1, 2)) == released


def test_weak_edge_makes_unit_seek_unshared_robots():
    """Of its neighbour's robots 2 to 7 it has 2 and 3; 4 and 5 are in another pair of the neighbour."""
    peer = report(1, 10.0, controls=range(2, 8), edges=[(0, 4, [2, 3]), (9, 4, [4, 5])])
    rule = TreeSettings(share="leverage", firm=1e6, gain=1.0)
    now = replace(situation(0, [peer]), settings=rule)
    edge = Edge(0, 1, 0.0, turn=4, pair=robots(2, 3))
    sought = seek_robots(NodeState(own=robots(0, 1), edges={1: edge}, tree_id=0), now).sought
    assert sought & robots(6, 7) and sought <= robots(2, 3, 6, 7)


@pytest.mark.parametrize(("since_s", "stays"), [(9.5, True), (0.0, False)])
def test_edge_to_silent_neighbor_is_removed_after_timeout(since_s, stays):
    state = NodeState(edges={1: Edge(0, 1, since_s, turn=4, pair=robots(1, 2))}, tree_id=0)
    assert (1 in fail_over(state, situation(0, [])).edges) == stays


def test_successor_without_heir_is_lowest_living_neighbor() -> None:
    """Unit 2 and its heir 1 fell silent at one time; 2 had pairs with 1, 3 and 5. Unit 3 succeeds."""
    gone = report(
        2, 6.9, controls=[0, 1, 2, 3, 4, 5], heir=1, edges=[(1, 4, (0, 1)), (3, 5, (2, 3)), (5, 5, (4, 5))]
    )
    heir = report(1, 7.1, controls=[0, 1], edges=[(2, 4, (0, 1))])
    for unit, other in ((3, 5), (5, 3)):
        now = situation(unit, [gone, heir, report(other, 9.8, controls=[6])])
        assert successor_of(now.peers.newest[2], now) == 3
    alive = situation(5, [gone, replace(heir, time_s=9.0), report(3, 9.8)])
    assert successor_of(alive.peers.newest[2], alive) == 1, "the heir, if it lives"
    alone = situation(5, [gone, heir, report(3, 7.0)])
    assert successor_of(alone.peers.newest[2], alone) == 5, "the surviving unit"


def test_two_waiting_ends_start_with_lower_unit() -> None:
    """Units 1 and 4 both considered themselves the successor of a unit between them, with different pairs."""
    ends = {
        unit: NodeState(
            tree_id=0, own=frozenset(own), edges={other: Edge(unit, other, 9.0, pair=frozenset(pair))}
        )
        for unit, other, own, pair in ((1, 4, {0}, (2, 3)), (4, 1, {7}, (5, 6)))
    }
    news = {
        unit: report(unit, 9.9, controls=sorted(ends[unit].controlled), edges=[(other, NO_TURN, pair)])
        for unit, other, pair in ((1, 4, (2, 3)), (4, 1, (5, 6)))
    }
    lower = receive_turns(ends[1], situation(1, [news[4]]))
    higher = receive_turns(ends[4], situation(4, [news[1]]))
    assert lower.edges[4].is_my_turn and lower.edges[4].pair == {2, 3}
    assert higher.edges[1].turn == NO_TURN, "the higher one waits"
    told = report(1, 10.1, controls=[0, 2, 3], edges=[(4, lower.edges[4].turn + 1, (2, 3))])
    higher = receive_turns(higher, situation(4, [told], time_s=10.2))
    assert higher.edges[1].pair == {2, 3} and higher.own == {5, 6, 7}
    assert higher.controlled & lower.controlled == {2, 3}
    unheard = report(4, 9.9, controls=[5], edges=[(1, 8, (2, 3))])
    assert receive_turns(ends[1], situation(1, [unheard])).edges[4].turn == 8, "a turn that is told is taken"


@pytest.mark.parametrize(
    ("ready", "living", "sought"), [(True, 9.5, {7}), (True, 6.0, {6, 7}), (False, 9.5, set())]
)
def test_uncontrolled_robots_are_sought(ready, living, sought):
    """Robots 0 to 5 are the unit's, 6 another's, which may be silent, and 7 is uncontrolled."""
    state = NodeState(own=robots(0, 1, 2, 3, 4, 5), tree_id=0, ready=ready)
    now = situation(0, [report(1, living, controls=[6])])
    assert seek_robots(state, now).sought == sought


@pytest.mark.parametrize(("imaged_s", "since_s"), [(9.8, 1.0), (7.1, 1.0), (6.9, 10.0), (-np.inf, 10.0)])
def test_unit_searches_again_after_silence_or_clock_change(imaged_s, since_s):
    """Its time counts from the image at 10 s if the one before is more than a silence timeout (3 s) ago."""
    noted = note_view(NodeState(imaged_s=imaged_s, since_s=1.0), situation(0, []))
    assert (noted.since_s, noted.imaged_s) == (since_s, 10.0)
