"""Failover: the heir of a silent neighbour takes over its robots and edges; other neighbours join the heir.

Each report serves as a heartbeat of its sender. A unit without a report for `silence_s` is declared dead. Two
adjacent units become one, so that a tree with one pair per edge remains such a tree.
"""

from dataclasses import replace

from skyherd.control.tree.edge import NO_ROBOTS, NO_TURN, Edge, Robots, first_turn
from skyherd.control.tree.node_state import NodeState, Situation, resigned
from skyherd.control.tree.peer_reports import PeerReport
from skyherd.messages import NO_ID

GRACE = 2
"""Number of silence timeouts after which the other end of a new edge must know it. Chosen: one in which the
report of the edge arrives, and one in which the answer does."""

RECENT = 0.5
"""Maximum age of the last heartbeat of a successor, as a share of the silence timeout. Chosen: half is seven
images at five a second, so that losing all their reports is unlikely."""


def fail_over(state: NodeState, context: Situation) -> NodeState:
    """Remove edges to silent neighbours and neighbours that left; rejoin if this unit was declared dead."""
    before = state
    for neighbor, edge in list(state.edges.items()):
        if state.edges.get(neighbor) is not edge:
            continue  # what was done about a neighbour before concerned this edge as well
        peer = context.peers.newest.get(neighbor)
        last_s = max(edge.since_s, context.heard_s(neighbor))
        if context.time_s - last_s > context.settings.silence_s:
            state = _without(state, context, edge)
        elif peer is not None and _is_abandoned(context, edge, peer):
            is_given_up = peer.is_member and bool(edge.pair)
            state = resigned(state) if is_given_up else _without(state, context, edge)
    return replace(
        before,
        own=state.own,
        edges=state.edges,
        ready=state.ready,
        tree_id=state.tree_id,
        asks_id=state.asks_id,
    )


def name_heir(state: NodeState, context: Situation) -> NodeState:
    """Select the heir: the neighbour with a pair and the fewest robots; keep it while its edge exists."""
    if state.heir_id in state.edges:
        return state
    robots = {
        neighbor: len(context.peers.newest[neighbor].controlled)
        for neighbor, edge in state.edges.items()
        if edge.pair and neighbor in context.peers.newest
    }
    heir_id = min(robots, key=lambda neighbor: (robots[neighbor], neighbor), default=NO_ID)
    return replace(state, heir_id=heir_id)


def _is_abandoned(context: Situation, edge: Edge, peer: PeerReport) -> bool:
    """Return whether the neighbour lacks the edge although it must know it by now: it then left the tree."""
    if context.unit_id in peer.tree.rows:
        return False
    if not edge.pair:
        return peer.is_member or (peer.tree.asks_id, peer.tree.ask_turn) != (context.unit_id, edge.turn)
    return not peer.is_member or peer.time_s > edge.since_s + GRACE * context.settings.silence_s


def _without(state: NodeState, context: Situation, edge: Edge) -> NodeState:
    """Return the state without the edge to a dead unit.

    The successor takes over the dead unit's robots and edges. Another neighbour keeps the pair as its own if
    it has an edge to the successor. Otherwise it creates an edge to the successor with that pair and has the
    first turn on it.
    """
    edges = {neighbor: other for neighbor, other in state.edges.items() if neighbor != edge.neighbor_id}
    state = replace(state, edges=edges)
    gone = context.peers.last_as_member.get(edge.neighbor_id)
    if gone is None or not edge.pair:
        return state
    successor = successor_of(gone, context)
    if successor == context.unit_id:
        return _inherit(replace(state, own=state.own | edge.pair), context, gone)
    if successor in state.edges:
        return replace(state, own=state.own | edge.pair)
    turn = first_turn(context.time_s, context.unit_id, successor)
    return _with_new_edge(state, context, successor, turn, edge.pair)


def successor_of(gone: PeerReport, context: Situation) -> int:
    """Return the successor of a dead unit: its heir, or its lowest living neighbour if the heir is dead.

    Simultaneous failures are not detected at the same time. Only units with a heartbeat younger than a share
    of the silence timeout count as living.
    """
    young_s = context.time_s - RECENT * context.settings.silence_s
    if gone.tree.heir_id == context.unit_id or context.heard_s(gone.tree.heir_id) >= young_s:
        return gone.tree.heir_id
    paired = (unit for unit, row in gone.tree.rows.items() if NO_ID not in gone.tree.pairs[row])
    return min({context.unit_id, *(unit for unit in paired if context.heard_s(unit) >= young_s)})


def _inherit(state: NodeState, context: Situation, gone: PeerReport) -> NodeState:
    """Return the state with the unclaimed robots of a dead unit and with its other edges.

    The other ends have the newest knowledge of their pairs with it, and report them in their first turn.
    """
    others = [peer.controlled for peer in context.living if peer.unit_id != gone.unit_id]
    state = replace(state, own=state.own | (gone.controlled - state.controlled.union(*others)))
    for neighbor, pair in zip(gone.tree.neighbor_ids.tolist(), gone.tree.pairs.tolist(), strict=True):
        if NO_ID not in pair and neighbor not in state.edges and context.is_alive(neighbor):
            state = _with_new_edge(state, context, neighbor, NO_TURN, frozenset(pair))
    return state


def _with_new_edge(state: NodeState, context: Situation, neighbor: int, turn: int, pair: Robots) -> NodeState:
    edge = Edge(context.unit_id, neighbor, context.time_s, turn=turn, pair=pair, offered=NO_ROBOTS)
    return replace(state, edges={**state.edges, neighbor: edge})
