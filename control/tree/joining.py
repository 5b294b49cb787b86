"""How units become one tree: one founds it, the others ask to be admitted and are granted an edge each."""

from dataclasses import replace

from skyherd.control.tree.edge import Edge, edge_status, first_turn, turn_time_s
from skyherd.control.tree.node_state import Extent, NodeState, Situation
from skyherd.control.tree.offers import offerable
from skyherd.control.tree.peer_reports import PeerReport
from skyherd.messages import NO_ID

STALLED_SLOTS = 1
"""Slots without growth after which units look around. Chosen: the shortest time in which an edge can be
granted and its first pair be taken; twice as long only delays deployment by a slot."""

PATIENT_SLOTS = 5
"""Slots after which a unit that was not granted an edge asks another member. Chosen: a grant that can be
given comes within two, once the robots that it needs are promised to nobody; a member with few robots of its
own may never have two to give."""


def join_tree(state: NodeState, now: Situation) -> NodeState:
    """Outside of a tree: ask a member to be admitted; if there is no tree, see that one is founded.

    Large control sets bind a team firmly (docs/topology.md), and the founder's set is all that it sees inside
    the radius. So the unit that sees most robots is to be the founder. For there to be one founder only,
    however late reports are, the lowest unit chooses: after a dwell time it founds the tree itself, or asks
    another unit to, and keeps to that choice while it receives reports of the chosen one, which may have
    founded the tree by then.
    """
    if state.is_member:
        return state
    if now.members:
        return _ask(state, now)
    living = {peer.unit_id: peer for peer in now.living}
    lowest = min(living, default=now.unit_id)
    if lowest < now.unit_id:
        return _found(state, now) if lowest in now.askers else state
    if not now.at_slot or now.time_s - state.since_s < now.rule.dwell_s or state.asks_id in living:
        return state
    inside = {unit: len(peer.near(now.rule.radius)) for unit, peer in living.items()}
    inside[now.unit_id] = len(now.visible)
    chosen = max(inside, key=lambda unit: (inside[unit], -unit))
    if chosen == now.unit_id:
        return _found(state, now)
    return replace(state, asks_id=chosen, ask_turn=first_turn(now.time_s, now.unit_id, chosen))


def _found(state: NodeState, now: Situation) -> NodeState:
    """Begin the tree, with all robots in view as the unit's own."""
    return replace(state, tree_id=now.unit_id, asks_id=NO_ID, own=now.visible)


def _ask(state: NodeState, now: Situation) -> NodeState:
    """Open the edge that the member that was asked grants; else ask the one with most own robots in common.

    The question names the turn at which the edge is to begin, another one each time, so that a grant that
    arrives late, after the question was given up, is void. Members are asked one after the other, each for
    `PATIENT_SLOTS`, and an edge on which there has been no pair for as long is given up: the robots that were
    offered may have gone to other units since. That is done in the unit's own turn, in which the member makes
    no pair.
    """
    patience_s = PATIENT_SLOTS * now.rule.dwell_s
    if any(
        edge.pair or not edge.is_my_turn or now.time_s - edge.since_s < patience_s
        for edge in state.edges.values()
    ):
        return state
    for peer in now.members:
        status = edge_status(peer.report, now.unit_id)
        if peer.unit_id == state.asks_id and status and not status.pair and status.turn == state.ask_turn:
            edge = Edge(now.unit_id, peer.unit_id, now.time_s).received(peer.report)
            return replace(state, edges={peer.unit_id: edge})
    common = {peer.unit_id: _common(now, peer) for peer in now.members}
    able = sorted((member for member in common if common[member] >= 2), key=lambda m: (-common[m], m))
    asked_s = now.time_s - turn_time_s(state.ask_turn)
    if state.asks_id in able and (len(able) == 1 or asked_s < patience_s):
        return state
    if not able:
        return state if state.edges else replace(state, asks_id=NO_ID)
    best = able[(able.index(state.asks_id) + 1) % len(able) if state.asks_id in able else 0]
    return replace(state, edges={}, asks_id=best, ask_turn=first_turn(now.time_s, now.unit_id, best))


def _common(now: Situation, member: PeerReport) -> int:
    """How many own robots of a member the unit sees as well."""
    return len(now.visible.intersection(member.report.secure_ids.tolist()) - member.paired)


def admit(state: NodeState, now: Situation) -> NodeState:
    """As a member: grant an edge, yet without a pair, to each unit that asks for one."""
    if not state.is_member:
        return state
    for asking in sorted(now.askers - state.edges.keys()):
        offered = offerable(state, now, asking)
        if len(offered) >= 2:
            turn = now.peers.newest[asking].tree.ask_turn
            edge = Edge(now.unit_id, asking, now.time_s, turn=turn, offered=offered)
            state = replace(state, edges={**state.edges, asking: edge})
    return state


def watch_growth(state: NodeState, now: Situation) -> NodeState:
    """Until the tree is complete: tell whether it is, and whether to look around because it does not grow.

    It is complete when all units heard of belong to it and all robots to a unit, when any unit that was heard
    of says so, or when the unit's patience has ended. Units look around before the tree has been founded, and
    from the first slot on in which it did not grow; meanwhile they hold their place, so that others can count
    on what they see.
    """
    if state.ready:
        return state
    outside = {peer.unit_id for peer in now.living if not peer.is_member}
    extent = Extent(
        frozenset(outside if state.is_member else outside | {now.unit_id}),
        state.controlled.union(*(peer.controlled for peer in now.living)),
    )
    is_begun = state.is_member or bool(now.members)
    grew_slot = now.slot if extent != state.extent or not is_begun else state.grew_slot
    stalled = state.stalled or now.slot - grew_slot >= STALLED_SLOTS
    ready = state.is_member and _is_complete(state, now, extent)
    return replace(
        state,
        extent=extent,
        grew_slot=grew_slot,
        stalled=stalled,
        ready=ready,
        searches=not ready and (stalled or not is_begun),
    )


def _is_complete(state: NodeState, now: Situation, extent: Extent) -> bool:
    is_reported = any(peer.tree.ready for peer in now.living)
    is_patience_over = now.time_s - state.since_s > now.rule.patience_s
    return is_reported or is_patience_over or (not extent.outside and extent.held >= now.shape.members)
