"""Interleavings that violate the tree protocol without a rule, written out; and the cost of a crash."""

from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from protocol_world import ProtocolWorld

from skyherd.control import Template, TreeSettings
from skyherd.control.tree.edge import NO_TURN, Edge, first_turn
from skyherd.control.tree.joining import join_tree
from skyherd.control.tree.node_state import NodeState, Situation
from skyherd.control.tree.offers import offerable
from skyherd.control.tree.orphans import adopt_orphans, yield_claims
from skyherd.control.tree.peer_reports import PeerReports
from skyherd.messages import NO_ID, TreeStatus, UnitReport

RULE = TreeSettings()
STEP_S = 0.5
NONE = np.array([], dtype=np.int64)


def everything(robots: int) -> dict[int, float]:
    """Return a view of all robots, well inside."""
    return {robot: 0.1 + 0.7 * robot / robots for robot in range(robots)}


def formed(units: int, robots: int) -> ProtocolWorld:
    """Return units that all see all robots, after the tree has grown."""
    return deepcopy(_formed(units, robots))


@cache
def _formed(units: int, robots: int) -> ProtocolWorld:
    world = ProtocolWorld(units, robots, RULE, [everything(robots) for _ in range(units)])
    world.quiet(20.0, STEP_S)
    assert world.in_p()
    return world


def no_tree() -> TreeStatus:
    """Return the status of a unit outside a tree without a request."""
    return TreeStatus(
        tree_id=NO_ID,
        asks_id=NO_ID,
        ask_turn=NO_TURN,
        heir_id=NO_ID,
        ready=False,
        neighbor_ids=NONE,
        turns=NONE,
        pairs=np.zeros((0, 2), dtype=np.int64),
        offered_ids=NONE,
        offered_to_ids=NONE,
        to_release_ids=NONE,
        missing_ids=NONE,
        handed_ids=NONE,
        handed_to_ids=NONE,
        handed_slots=NONE,
        accepted_ids=NONE,
    )


def member_report(unit_id: int, time_s: float, controlled, seen: dict[int, float], pair=()) -> UnitReport:
    """Return the report of a member; its edge, if any, is to unit 99."""
    edges = 1 if pair else 0
    status = TreeStatus(
        tree_id=0,
        asks_id=NO_ID,
        ask_turn=NO_TURN,
        heir_id=NO_ID,
        ready=True,
        neighbor_ids=np.full(edges, 99),
        turns=np.zeros(edges, dtype=int),
        pairs=np.array([pair] if pair else [], dtype=int).reshape(-1, 2),
        offered_ids=NONE,
        offered_to_ids=NONE,
        to_release_ids=NONE,
        missing_ids=NONE,
        handed_ids=NONE,
        handed_to_ids=NONE,
        handed_slots=NONE,
        accepted_ids=NONE,
    )
    points = np.array([[399.5 + 400 * at, 399.5] for at in seen.values()]).reshape(-1, 2)
    ids, controlled = np.array(list(seen), dtype=int), np.array(sorted(controlled), dtype=int)
    return UnitReport(unit_id, time_s, np.array([800, 800]), ids, points, controlled, NONE, status)


def member(unit_id: int, own: set[int], held_s: float, reports: list[UnitReport], **changes):
    """Return state and context, at 10 s, of a member that has received these reports."""
    state = NodeState(own=frozenset(own), tree_id=0, slot=5, held_s=dict.fromkeys(own, held_s), **changes)
    return state, situation(unit_id, 10.0, reports)


def situation(unit_id: int, time_s: float, reports: list[UnitReport], distances=None, at_slot: bool = True):
    """Return the context of a unit at an image with robots at these distances."""
    peers = PeerReports()
    return Situation(
        settings=RULE,
        shape=Template(np.arange(8), np.exp(1j * np.arange(8))),
        unit_id=unit_id,
        time_s=time_s,
        slot=int(time_s // RULE.dwell_s),
        at_slot=at_slot,
        distances=distances or {},
        news=peers.take(reports),
        peers=peers,
    )


# --- claims ---


@pytest.mark.parametrize(("said_s", "kept"), [(8.9, {4, 5}), (9.1, {5})])
def test_stale_report_is_no_claim(said_s, kept) -> None:
    """Robot 4 passed from unit 0 via unit 1 to unit 2, at 9 s, which received unit 0's report before that.

    If unit 2 dropped it because of unit 0, which no longer had it, the robot would be uncontrolled.
    """
    state, now = member(2, {4, 5}, 9.0, [member_report(0, said_s, {3, 4}, {})])
    assert yield_claims(state, now).own == kept


def test_higher_unit_yields_claim_and_pair_does_not() -> None:
    """Robot 4 is both units' own: the lower one keeps it. Robot 5 is in another pair: its owner yields."""
    claims = {"controlled": {4, 5, 6}, "seen": {}, "pair": (5, 6)}
    low, high = (
        yield_claims(*member(unit, {4, 5}, 5.0, [member_report(other, 9.0, **claims)]))
        for unit, other in ((1, 2), (2, 1))
    )
    assert (low.own, high.own) == ({4}, set())


@pytest.mark.parametrize(
    ("said_s", "claimed", "offered"),
    [
        pytest.param(9.5, (), {2, 3}, id="a word since, which does not claim them"),
        pytest.param(8.5, (), set(), id="no word since it has them: another may have adopted them too"),
        pytest.param(9.5, (2,), {3}, id="one of them claimed"),
    ],
)
def test_only_undisputed_robots_are_offered(said_s, claimed, offered) -> None:
    """Two units adopted robot 2 at once. If each offered it, two pairs would contain it permanently."""
    reports = [
        member_report(1, 9.8, (), everything(8)),
        member_report(3, said_s, claimed, {}),
    ]
    edge = Edge(0, 1, since_s=0.0, turn=0, pair=frozenset({6, 7}))
    state, now = member(0, {2, 3}, 9.0, reports, edges={1: edge})
    assert offerable(state, now, 1) == offered


@pytest.mark.parametrize(("said_s", "adopts"), [(7.9, False), (8.0, True)])
def test_orphan_needs_reports_of_all_units_in_same_slot(said_s, adopts) -> None:
    """Unit 1 gave robot 4 to unit 2, which took it at 7.95 s; its last report is from before.

    At the slot of 10 s a report of the slot from 8 s on is valid; an older one is not.
    """
    reports = [member_report(1, 9.9, (), {}), member_report(2, said_s, (), {})]
    state, _ = member(0, set(), 0.0, reports)
    for time_s, at_slot in ((8.1, False), (10.0, True)):
        now = situation(0, time_s, reports, distances={4: 0.3}, at_slot=at_slot)
        state = adopt_orphans(state, now)
    assert (4 in state.own) == adopts


# --- joining ---


def test_late_grant_of_withdrawn_request_is_void() -> None:
    """Unit 1 asks unit 0, sees too few robots for a moment, and asks again; then the first grant arrives.

    Unit 0 had withdrawn it and offered the robots to another unit. The turns would differ permanently.
    """
    world = ProtocolWorld(2, 5, RULE, [everything(5), {}])
    world.quiet(4.0, STEP_S)
    assert world.sets[0] == set(range(5))

    def step(*, deliver_to: int | None = None) -> None:
        """Give both units an image; reports arrive at one unit only, the others wait."""
        world.time_s += 0.1
        for unit in (0, 1):
            if unit == deliver_to:
                world.deliver_to(unit)
            world.image(unit)

    world.views[1] = everything(5)
    step()
    step()
    step(deliver_to=0)
    grant = world.latest[0]
    assert grant.tree.neighbor_ids.tolist() == [1]
    world.views[1] = {}
    step()
    step(deliver_to=0)
    assert not world.nodes[0].state.edges, "withdrawn"
    world.views[1] = everything(5)
    world.waiting.clear()
    world.time_s += 0.1
    world.image(1)
    assert world.nodes[1].state.asks_id == 0
    world.inbox[1][0] = grant
    world.time_s += 0.1
    world.image(1)
    assert not world.nodes[1].state.edges
    world.quiet(6.0, STEP_S)
    assert world.in_p() and not world.edge_faults()


def test_requesting_unit_gets_both_robots_of_pair() -> None:
    """Unit 1 has robots 4 and 5 left, which units 0 and 2 see; unit 0 asks, unit 2 is a neighbour.

    If each got one of them in every slot, which makes no pair, unit 0 would never be admitted.
    """
    neighbor = member_report(2, 9.9, (), everything(8), pair=(6, 7))
    asking = member_report(0, 9.9, (), everything(8))
    asking = replace(asking, tree=replace(asking.tree, tree_id=NO_ID, asks_id=1, ask_turn=9000))
    edge = Edge(1, 2, since_s=0.0, turn=0, pair=frozenset({6, 7}))
    state, now = member(1, {4, 5}, 5.0, [neighbor, asking], edges={2: edge})
    assert now.askers == {0}
    for slot in range(5, 9):
        at = replace(now, slot=slot)
        assert {offerable(state, at, 0), offerable(state, at, 2)} == {frozenset({4, 5}), frozenset()}


def admitting(unit_id: int, robots: tuple[int, ...]) -> UnitReport:
    """Return the report of a member that could share these robots."""
    return replace(
        member_report(unit_id, 19.9, robots, everything(8)), secure_ids=np.array(robots, dtype=np.int64)
    )


@pytest.mark.parametrize(
    ("asked", "asked_at_s", "asks"),
    [(NO_ID, 0.0, 0), (0, 11.0, 0), (0, 9.0, 2), (2, 9.0, 3), (3, 9.0, 0), (1, 19.0, 0)],
    ids=[
        "the most",
        "patient",
        "the next",
        "the one after",
        "the first again",
        "one that has too few by now",
    ],
)
def test_rejected_unit_asks_members_in_turn(asked, asked_at_s, asks) -> None:
    """At 20 s: unit 0 has three robots in common with it, units 2 and 3 two, unit 1 one. Five slots are 10 s.

    In one of a thousand missions a unit asked a member for minutes that had promised all of its robots to
    others, while another had twenty.
    """
    common = {0: (0, 1, 2), 1: (3,), 2: (6, 7), 3: (4, 5)}
    reports = [admitting(unit, robots) for unit, robots in common.items()]
    state = NodeState(slot=9, asks_id=asked, ask_turn=first_turn(asked_at_s, 4, max(asked, 0)))
    changed = join_tree(state, situation(4, 20.0, reports, everything(8)))
    assert changed.asks_id == asks
    assert changed.ask_turn == (state.ask_turn if asks == asked else first_turn(20.0, 4, asks)), (
        "another question, another turn"
    )


@pytest.mark.parametrize(
    ("since_s", "turn", "pair", "gives_up"),
    [(9.0, 8, (), True), (11.0, 8, (), False), (9.0, 9, (), False), (9.0, 8, (0, 1), False)],
    ids=["five slots without a pair", "not yet", "not in the other's turn", "with a pair"],
)
def test_edge_without_pair_is_replaced_by_other_member(since_s, turn, pair, gives_up) -> None:
    """At 20 s, for unit 4's edge to unit 5, whose turns are odd, and which has no robots left to share."""
    edge = Edge(4, 5, since_s=since_s, turn=turn, pair=frozenset(pair))
    assert edge.is_my_turn == (turn == 8)
    state = NodeState(slot=9, asks_id=5, ask_turn=first_turn(9.0, 4, 5), edges={5: edge})
    changed = join_tree(state, situation(4, 20.0, [admitting(5, ()), admitting(0, (0, 1))], everything(8)))
    told = {"edges": {}, "asks_id": 0, "ask_turn": first_turn(20.0, 4, 0)}
    assert changed == (replace(state, **told) if gives_up else state)


def test_only_suitable_member_is_asked_without_limit() -> None:
    reports = [admitting(0, (0, 1)), admitting(1, (2,))]
    state = NodeState(slot=9, asks_id=0, ask_turn=first_turn(0.0, 4, 0))
    assert join_tree(state, situation(4, 20.0, reports, everything(8))) == state


def test_founder_requests_no_admission() -> None:
    world = ProtocolWorld(2, 5, RULE, [everything(5), everything(5)])
    world.quiet(10.0, STEP_S)
    world.crash(0)
    world.quiet(10.0, STEP_S)
    assert world.nodes[1].state.asks_id == NO_ID


def test_founder_choice_stays_while_report_is_in_transit() -> None:
    """Unit 0 chose unit 1, which founded the tree and then lost sight of its additional robots."""
    world = ProtocolWorld(2, 6, RULE, [{4: 0.1, 5: 0.1}, {3: 0.1, 4: 0.1, 5: 0.1}])
    world.image(0)
    world.quiet(RULE.dwell_s - STEP_S, STEP_S)
    world.time_s = RULE.dwell_s
    world.image(0)
    world.deliver_all()
    assert world.nodes[0].state.asks_id == 1
    del world.views[1][4]
    world.image(1)
    founded = world.waiting.pop()[1]
    assert world.sets[1] == {3, 5}
    # Unit 0 knows by now that unit 1 sees no more than itself, and not yet that it founded the tree.
    world.inbox[0][1] = replace(founded, controlled_ids=NONE, secure_ids=NONE, tree=no_tree())
    world.time_s += RULE.dwell_s
    world.image(0)
    assert not world.nodes[0].state.is_member
    world.inbox[0][1] = founded
    world.quiet(3 * RULE.dwell_s, STEP_S)
    assert world.holders().keys() == {3, 5}


# --- succession ---


@pytest.mark.smoke
@pytest.mark.parametrize("units", [2, 3])
@pytest.mark.parametrize("when", range(8))
def test_crash_is_repaired_after_silence_and_two_images(units, when) -> None:
    """Any unit, at any image of two dwell times: without other faults TC1-TC5 hold again by then, and stay.

    The heir takes over the dead unit's robots and edges at its first image after the silence timeout. The
    others join the heir at theirs.
    """
    for dead in range(units):
        world = formed(units, 4 * units)
        world.quiet(when * STEP_S, STEP_S)
        world.crash(dead)
        world.quiet(RULE.silence_s + 2 * STEP_S, STEP_S)
        for _ in range(20):
            assert world.in_p() and not world.edge_faults()
            world.quiet(STEP_S, STEP_S)


@pytest.mark.parametrize("dead", range(3))
def test_unit_back_before_timeout_is_succeeded_and_admitted(dead) -> None:
    """It has no memory of its edges. Its neighbours use its last report as a member, not its present one.

    Otherwise they would take its pairs as their own, without an edge between them.
    """
    world = formed(3, 12)
    world.crash(dead)
    world.quiet(2 * STEP_S, STEP_S)
    world.revive(dead)
    world.quiet(3 * RULE.dwell_s, STEP_S)
    for _ in range(20):
        assert world.in_p() and len(world.nodes[dead].state.edges) >= 1
        world.quiet(STEP_S, STEP_S)


@pytest.mark.parametrize("one", range(3))
@pytest.mark.parametrize("both_ways", [True, False])
def test_partition_is_healed(one, both_ways) -> None:
    """A unit and all others do not receive each other, or it alone does not, for three silence timeouts.

    Each side continues without the other and both have all robots. Without healing they remain two trees of
    one number.
    """
    world = formed(3, 12)
    for _ in range(round(3 * RULE.silence_s / STEP_S)):
        world.time_s += STEP_S
        for unit in range(3):
            world.waiting = [
                (to, report)
                for to, report in world.waiting
                if to != one and (report.unit_id != one or not both_ways)
            ]
            world.deliver_all()
            world.image(unit)
    assert not world.in_p()
    world.quiet(2 * RULE.silence_s + 3 * RULE.dwell_s, STEP_S)
    for _ in range(20):
        assert world.in_p() and not world.edge_faults()
        world.quiet(STEP_S, STEP_S)


def test_no_pair_is_compared_with_empty_neighbor() -> None:
    """The neighbour left the tree while the turn was here: its empty set allows no comparison of pairs."""
    world = formed(2, 6)
    node = world.nodes[0]
    while not node.state.edges[1].is_my_turn:
        world.time_s += STEP_S
        for index in (1, 0):
            world.deliver_all()
            world.image(index)
            if node.state.edges[1].is_my_turn:
                break
        edge = node.state.edges[1]
        if not edge.is_my_turn:  # handed over at once: hold it as one that waits for a slot
            node.state = replace(node.state, edges={1: replace(edge, turn=edge.turn + 1)})
    world.deliver_all()
    report = world.latest[1]
    gone = replace(report.tree, tree_id=NO_ID, neighbor_ids=NONE, turns=NONE, pairs=np.zeros((0, 2)))
    lost = replace(report, time_s=world.time_s + 1.9, controlled_ids=NONE, secure_ids=NONE)
    lost = replace(lost, tree=replace(gone, offered_ids=NONE, offered_to_ids=NONE, to_release_ids=NONE))
    world.time_s += RULE.dwell_s
    world.inbox[0][1] = lost
    world.image(0)
    assert world.sets[0] == set(range(6))


# --- adoption ---


@pytest.mark.parametrize("seers", [{0}, {2}, {0, 1, 2}])
@pytest.mark.parametrize("when", range(4))
def test_new_robot_is_adopted_within_one_and_a_half_dwell_times(seers, when) -> None:
    """Half a dwell time without a claim, the next slot after that, and an image."""
    world = formed(3, 12)
    for unit in range(3):
        del world.views[unit][11]
    for node in world.nodes.values():
        node.state = replace(node.state, own=node.state.own - {11})
    world.quiet(RULE.silence_s + when * STEP_S, STEP_S)
    assert not world.holders()[11]
    for unit in seers:
        world.views[unit][11] = 0.2 + 0.1 * unit
    world.quiet(1.5 * RULE.dwell_s + STEP_S, STEP_S)
    assert {unit for unit in range(3) if 11 in world.sets[unit]} == {min(seers)}
    world.quiet(STEP_S, STEP_S)
    assert world.in_p()


@pytest.mark.parametrize("when", range(4))
def test_moved_robot_is_handed_over_after_silence_and_two_slots(when) -> None:
    """Its unit announces it at the first slot after a silence timeout, and hands it over with the next one.

    All units take their images at the same instants, and at each of these one unit has it: TC1-TC5 hold
    throughout.
    """
    world = formed(2, 9)
    world.quiet(when * STEP_S, STEP_S)
    robot = max(world.nodes[0].state.own - world.nodes[1].state.controlled)
    for unit in (0, 1):
        del world.views[unit][robot]
    world.quiet(STEP_S, STEP_S)
    holder = next(unit for unit in (0, 1) if robot in world.sets[unit])
    world.views[1 - holder][robot] = 0.3
    for _ in range(round((RULE.silence_s + 2 * RULE.dwell_s) / STEP_S) + 1):
        world.quiet(STEP_S, STEP_S)
        assert world.in_p() and world.holders()[robot] == 1
    assert robot in world.sets[1 - holder] and robot not in world.nodes[holder].state.own
