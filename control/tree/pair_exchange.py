"""Turns on the edges: received with a report, used to exchange the pair, and handed over again."""

from dataclasses import replace

import numpy as np

from skyherd.control.tree.edge import NO_ROBOTS, NO_TURN, Edge, Robots, edge_status, first_turn
from skyherd.control.tree.node_state import NodeState, Situation
from skyherd.control.tree.offers import offerable
from skyherd.control.tree.pair_selection import choose_pair
from skyherd.control.tree.peer_reports import PeerReport
from skyherd.messages import NO_ID


def receive_turns(state: NodeState, now: Situation) -> NodeState:
    """Take the turns that the reports hand over.

    The neighbour may have exchanged the pair in its turn. A robot that left the pair is the unit's own again,
    and one that came into it, which the unit had offered, is its own no more; the unit's control set stays as
    it is.

    Where both ends of an edge wait for the first turn of the other, because both took themselves for the
    successor of a dead unit between them, the lower unit begins, with the pair that it knows.
    """
    own, edges = state.own, dict(state.edges)
    for peer in now.news:
        if peer.unit_id in edges:
            before = edges[peer.unit_id].pair
            edges[peer.unit_id] = _begun(edges[peer.unit_id].received(peer.report), peer, now)
            own = (own | (before - edges[peer.unit_id].pair)) - edges[peer.unit_id].pair
    return replace(state, own=own, edges=edges)


def _begun(edge: Edge, peer: PeerReport, now: Situation) -> Edge:
    """The edge with the lower unit's first turn if both ends wait for the other's; else as it is."""
    if edge.turn != NO_TURN or not edge.pair or now.unit_id > edge.neighbor_id:
        return edge
    status = edge_status(peer.report, now.unit_id)
    if status is None or not status.pair or status.turn != NO_TURN:
        return edge
    return replace(edge, turn=first_turn(now.time_s, now.unit_id, edge.neighbor_id))


def use_turns(state: NodeState, now: Situation) -> NodeState:
    """Exchange the pair where it is the unit's turn and another pair is better, then hand the turn over.

    A unit that has nothing to change hands the turn over at once; else it waits for the next slot, changes
    the pair there if that is still better, and hands over. It looks for a better pair only in a new slot, or
    when other robots have come into its reach. With the first pair of its first edge a unit becomes a member
    of the neighbour's tree.
    """
    before = state
    for neighbor in list(state.edges):
        edge = state.edges[neighbor]
        if not edge.is_my_turn:
            continue
        at_hand, wants = (now.slot, edge.reach), edge.wants
        if now.at_slot or edge.considered != at_hand:
            pair = _better_pair(state, now, edge)
            if now.at_slot and pair is not None:
                state = _exchanged(state, now, edge, pair)
                edge = state.edges[neighbor]
            wants = pair is not None and not now.at_slot
        edge = replace(edge, considered=at_hand, wants=wants)
        if not wants:
            offered = offerable(state, now, neighbor)
            edge = edge.handed_over(offered, _to_release(now, edge, offered))
        state = _with_edge(state, edge)
    return replace(before, edges=state.edges, tree_id=state.tree_id, ready=state.ready, asks_id=state.asks_id)


def _with_edge(state: NodeState, edge: Edge) -> NodeState:
    return replace(state, edges={**state.edges, edge.neighbor_id: edge})


def _exchanged(state: NodeState, now: Situation, edge: Edge, pair: Robots) -> NodeState:
    """The state with `pair` shared instead of the present pair, which the neighbour keeps."""
    state = _with_edge(state, replace(edge, pair=pair))
    if state.is_member:
        return state
    tree = now.peers.newest[edge.neighbor_id].tree
    return replace(state, tree_id=tree.tree_id, ready=tree.ready, asks_id=NO_ID)


def _better_pair(state: NodeState, now: Situation, edge: Edge) -> Robots | None:
    """The pair to exchange the present one for; None if none is better."""
    neighbor = now.peers.newest[edge.neighbor_id]
    ours = state.controlled - edge.pair
    within_view = now.visible & (neighbor.near(now.rule.radius) | edge.to_release)
    return choose_pair(
        now.rule.share,
        now.shape,
        candidates=frozenset((edge.pair | edge.reach) & neighbor.controlled & within_view - ours),
        distances=now.distances,
        present=edge.pair,
        theirs=neighbor.report.controlled_ids,
        ours=np.array(sorted(ours), dtype=np.int64),
        to_take=edge.to_release,
        to_leave=edge.pair & edge.releasing,
        gain=now.rule.gain,
    )


def _to_release(now: Situation, edge: Edge, offered: Robots) -> Robots:
    """Of the robots offered, those that leave the unit's view and that the neighbour sees inside its radius.

    None, if the unit could take none of the neighbour's robots in return: the pair would only go to and fro.
    """
    neighbor = now.peers.newest[edge.neighbor_id]
    near = neighbor.near(now.rule.radius)
    if len((neighbor.controlled - neighbor.paired) & now.visible & near) < 2:
        return NO_ROBOTS
    leaving = now.rule.radius * (1 + now.rule.hysteresis)
    return frozenset(r for r in offered & near if now.distances.get(r, np.inf) > leaving)
