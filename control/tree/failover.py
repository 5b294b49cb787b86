"""When a neighbour falls silent: its heir takes over its robots and edges, the others turn to the heir.

Two adjoining units are made one, so that what was a tree with one pair an edge still is.
"""

from dataclasses import replace

from skyherd.control.tree.edge import NO_ROBOTS, NO_TURN, Edge, Robots, first_turn
from skyherd.control.tree.node_state import NodeState, Situation, resigned
from skyherd.control.tree.peer_reports import PeerReport
from skyherd.messages import NO_ID

GRACE = 2
"""Silences after which the other end of a new edge must know of it. Chosen: one in which the report of the
edge arrives for certain, and one in which the answer does."""

LIVELY = 0.5
"""Share of the silence in which a unit must have been heard of to succeed another one. Chosen: half, which is
seven images of a camera with five a second, so that hardly ever all of their reports are lost."""


def fail_over(state: NodeState, now: Situation) -> NodeState:
    """Go on without neighbours that fell silent or left the tree; start anew if they gave this unit up."""
    before = state
    for neighbor, edge in list(state.edges.items()):
        if state.edges.get(neighbor) is not edge:
            continue  # what was done about a neighbour before concerned this edge as well
        peer = now.peers.newest.get(neighbor)
        last_s = max(edge.since_s, now.heard_s(neighbor))
        if now.time_s - last_s > now.rule.silence_s:
            state = _without(state, now, edge)
        elif peer is not None and _is_abandoned(now, edge, peer):
            is_given_up = peer.is_member and bool(edge.pair)
            state = resigned(state) if is_given_up else _without(state, now, edge)
    return replace(
        before,
        own=state.own,
        edges=state.edges,
        ready=state.ready,
        tree_id=state.tree_id,
        asks_id=state.asks_id,
    )


def name_heir(state: NodeState, now: Situation) -> NodeState:
    """Name as the heir, of the neighbours with a pair, the one with fewest robots, and keep to it."""
    if state.heir_id in state.edges:
        return state
    robots = {
        neighbor: len(now.peers.newest[neighbor].controlled)
        for neighbor, edge in state.edges.items()
        if edge.pair and neighbor in now.peers.newest
    }
    heir_id = min(robots, key=lambda neighbor: (robots[neighbor], neighbor), default=NO_ID)
    return replace(state, heir_id=heir_id)


def _is_abandoned(now: Situation, edge: Edge, peer: PeerReport) -> bool:
    """Whether the neighbour knows nothing of the edge, although it must by now: then it left the tree."""
    if now.unit_id in peer.tree.rows:
        return False
    if not edge.pair:
        return peer.is_member or (peer.tree.asks_id, peer.tree.ask_turn) != (now.unit_id, edge.turn)
    return not peer.is_member or peer.time_s > edge.since_s + GRACE * now.rule.silence_s


def _without(state: NodeState, now: Situation, edge: Edge) -> NodeState:
    """The state without the edge to a unit that is gone.

    Its successor takes over what was its. Another neighbour keeps the pair as its own if it has an edge to
    the successor, and else opens one with that pair and has the first turn on it.
    """
    edges = {neighbor: other for neighbor, other in state.edges.items() if neighbor != edge.neighbor_id}
    state = replace(state, edges=edges)
    gone = now.peers.last_as_member.get(edge.neighbor_id)
    if gone is None or not edge.pair:
        return state
    successor = successor_of(gone, now)
    if successor == now.unit_id:
        return _inherit(replace(state, own=state.own | edge.pair), now, gone)
    if successor in state.edges:
        return replace(state, own=state.own | edge.pair)
    turn = first_turn(now.time_s, now.unit_id, successor)
    return _with_new_edge(state, now, successor, turn, edge.pair)


def successor_of(gone: PeerReport, now: Situation) -> int:
    """Who takes over what was a dead unit's: its heir, or if that is gone too its lowest living neighbour.

    Units that fall silent at one time are not noticed at one time, so that only those count as living whose
    last report is younger than a share of the silence.
    """
    young_s = now.time_s - LIVELY * now.rule.silence_s
    if gone.tree.heir_id == now.unit_id or now.heard_s(gone.tree.heir_id) >= young_s:
        return gone.tree.heir_id
    paired = (unit for unit, row in gone.tree.rows.items() if NO_ID not in gone.tree.pairs[row])
    return min({now.unit_id, *(unit for unit in paired if now.heard_s(unit) >= young_s)})


def _inherit(state: NodeState, now: Situation, gone: PeerReport) -> NodeState:
    """The state with the robots of a dead unit, unless somebody else has them, and with its other edges.

    The other ends know best which pairs they had with it: their first turn tells.
    """
    others = [peer.controlled for peer in now.living if peer.unit_id != gone.unit_id]
    state = replace(state, own=state.own | (gone.controlled - state.controlled.union(*others)))
    for neighbor, pair in zip(gone.tree.neighbor_ids.tolist(), gone.tree.pairs.tolist(), strict=True):
        if NO_ID not in pair and neighbor not in state.edges and now.is_alive(neighbor):
            state = _with_new_edge(state, now, neighbor, NO_TURN, frozenset(pair))
    return state


def _with_new_edge(state: NodeState, now: Situation, neighbor: int, turn: int, pair: Robots) -> NodeState:
    edge = Edge(now.unit_id, neighbor, now.time_s, turn=turn, pair=pair, offered=NO_ROBOTS)
    return replace(state, edges={**state.edges, neighbor: edge})
