"""Formation of the tree: one unit founds it, the others request admission and get an edge each."""

from dataclasses import replace

from skyherd.control.tree.edge import Edge, edge_status, first_turn, turn_time_s
from skyherd.control.tree.node_state import Extent, NodeState, Situation
from skyherd.control.tree.offers import offerable
from skyherd.control.tree.peer_reports import PeerReport
from skyherd.messages import NO_ID

STALLED_SLOTS = 1
"""Number of slots without growth after which units search. Chosen: the shortest time to grant an edge and
take its first pair; twice the value only delays deployment by a slot."""

PATIENT_SLOTS = 5
"""Number of slots after which a unit without an edge asks another member. Chosen: a possible grant comes
within two; a member with few own robots may never have two to give."""


def join_tree(state: NodeState, context: Situation) -> NodeState:
    """Request admission by a member; without a tree, found one or select its founder.

    Large control sets couple a team strongly (docs/topology.md), and the founder's set is all that it sees
    inside the radius. The unit that sees most robots should therefore be the founder. To ensure a single
    founder despite late reports, the lowest unit decides. After a dwell time it founds the tree itself or
    asks another unit to. It keeps that choice while it receives reports of the chosen unit, which may have
    founded the tree by then.
    """
    if state.is_member:
        return state
    if context.members:
        return _ask(state, context)
    living = {peer.unit_id: peer for peer in context.living}
    lowest = min(living, default=context.unit_id)
    if lowest < context.unit_id:
        return _found(state, context) if lowest in context.askers else state
    if (
        not context.at_slot
        or context.time_s - state.since_s < context.settings.dwell_s
        or state.asks_id in living
    ):
        return state
    inside = {unit: len(peer.near(context.settings.radius)) for unit, peer in living.items()}
    inside[context.unit_id] = len(context.visible)
    chosen = max(inside, key=lambda unit: (inside[unit], -unit))
    if chosen == context.unit_id:
        return _found(state, context)
    return replace(state, asks_id=chosen, ask_turn=first_turn(context.time_s, context.unit_id, chosen))


def _found(state: NodeState, context: Situation) -> NodeState:
    """Found the tree, with all robots in view as the unit's own."""
    return replace(state, tree_id=context.unit_id, asks_id=NO_ID, own=context.visible)


def _ask(state: NodeState, context: Situation) -> NodeState:
    """Open the edge that the requested member grants; otherwise ask the one with most own robots in common.

    The request contains the turn at which the edge must begin, a different one each time. A grant that
    arrives after the request was withdrawn is therefore void. Members are asked one after the other, each for
    `PATIENT_SLOTS`. An edge without a pair for as long is removed: the offered robots may have gone to other
    units since. The removal takes place in the unit's own turn, in which the member makes no pair.
    """
    patience_s = PATIENT_SLOTS * context.settings.dwell_s
    if any(
        edge.pair or not edge.is_my_turn or context.time_s - edge.since_s < patience_s
        for edge in state.edges.values()
    ):
        return state
    for peer in context.members:
        status = edge_status(peer.report, context.unit_id)
        if peer.unit_id == state.asks_id and status and not status.pair and status.turn == state.ask_turn:
            edge = Edge(context.unit_id, peer.unit_id, context.time_s).received(peer.report)
            return replace(state, edges={peer.unit_id: edge})
    common = {peer.unit_id: _common(context, peer) for peer in context.members}
    able = sorted((member for member in common if common[member] >= 2), key=lambda m: (-common[m], m))
    asked_s = context.time_s - turn_time_s(state.ask_turn)
    if state.asks_id in able and (len(able) == 1 or asked_s < patience_s):
        return state
    if not able:
        return state if state.edges else replace(state, asks_id=NO_ID)
    best = able[(able.index(state.asks_id) + 1) % len(able) if state.asks_id in able else 0]
    return replace(state, edges={}, asks_id=best, ask_turn=first_turn(context.time_s, context.unit_id, best))


def _common(context: Situation, member: PeerReport) -> int:
    """Return the number of own robots of a member that the unit sees as well."""
    return len(context.visible.intersection(member.report.secure_ids.tolist()) - member.paired)


def admit(state: NodeState, context: Situation) -> NodeState:
    """Grant an edge, still without a pair, to each unit that requests one."""
    if not state.is_member:
        return state
    for asking in sorted(context.askers - state.edges.keys()):
        offered = offerable(state, context, asking)
        if len(offered) >= 2:
            turn = context.peers.newest[asking].tree.ask_turn
            edge = Edge(context.unit_id, asking, context.time_s, turn=turn, offered=offered)
            state = replace(state, edges={**state.edges, asking: edge})
    return state


def watch_growth(state: NodeState, context: Situation) -> NodeState:
    """Detect whether the tree is complete, and whether to search because it does not grow.

    The tree is complete if all known units belong to it and all robots to a unit. It also counts as complete
    if any known unit reports so, or if the unit's patience has ended. Units search before the tree is
    founded, and from the first slot without growth. Until then they hold their position, so that other units
    can rely on their views.
    """
    if state.ready:
        return state
    outside = {peer.unit_id for peer in context.living if not peer.is_member}
    extent = Extent(
        frozenset(outside if state.is_member else outside | {context.unit_id}),
        state.controlled.union(*(peer.controlled for peer in context.living)),
    )
    is_begun = state.is_member or bool(context.members)
    grew_slot = context.slot if extent != state.extent or not is_begun else state.grew_slot
    stalled = state.stalled or context.slot - grew_slot >= STALLED_SLOTS
    ready = state.is_member and _is_complete(state, context, extent)
    return replace(
        state,
        extent=extent,
        grew_slot=grew_slot,
        stalled=stalled,
        ready=ready,
        searches=not ready and (stalled or not is_begun),
    )


def _is_complete(state: NodeState, context: Situation, extent: Extent) -> bool:
    is_reported = any(peer.tree.ready for peer in context.living)
    is_patience_over = context.time_s - state.since_s > context.settings.patience_s
    return is_reported or is_patience_over or (not extent.outside and extent.held >= context.shape.members)
