"""Turns on the edges: received with a report, used to exchange the pair, and handed over again."""

from dataclasses import replace

import numpy as np

from skyherd.control.tree.edge import NO_ROBOTS, NO_TURN, Edge, Robots, edge_status, first_turn
from skyherd.control.tree.node_state import NodeState, Situation
from skyherd.control.tree.offers import offerable
from skyherd.control.tree.pair_selection import choose_pair
from skyherd.control.tree.peer_reports import PeerReport
from skyherd.messages import NO_ID


def receive_turns(state: NodeState, context: Situation) -> NodeState:
    """Take the turns that the reports hand over.

    The neighbour may have exchanged the pair in its turn. A robot that left the pair is the unit's own again.
    A robot that entered it, which the unit had offered, is no longer its own. The unit's control set stays
    the same.

    If both ends of an edge wait for the first turn of the other, the lower unit begins, with its known pair.
    This happens if both considered themselves the successor of a dead unit between them.
    """
    own, edges = state.own, dict(state.edges)
    for peer in context.news:
        if peer.unit_id in edges:
            before = edges[peer.unit_id].pair
            edges[peer.unit_id] = _begun(edges[peer.unit_id].received(peer.report), peer, context)
            own = (own | (before - edges[peer.unit_id].pair)) - edges[peer.unit_id].pair
    return replace(state, own=own, edges=edges)


def _begun(edge: Edge, peer: PeerReport, context: Situation) -> Edge:
    """Return the edge with the lower unit's first turn if both ends wait for the other's; else unchanged."""
    if edge.turn != NO_TURN or not edge.pair or context.unit_id > edge.neighbor_id:
        return edge
    status = edge_status(peer.report, context.unit_id)
    if status is None or not status.pair or status.turn != NO_TURN:
        return edge
    return replace(edge, turn=first_turn(context.time_s, context.unit_id, edge.neighbor_id))


def use_turns(state: NodeState, context: Situation) -> NodeState:
    """Exchange the pair if the unit has the turn and another pair is better, then hand the turn over.

    A unit without a change hands the turn over at once. Otherwise it waits for the next slot, changes the
    pair there if that is still better, and hands over. It searches for a better pair only in a new slot, or
    when other robots have come into its reach. With the first pair of its first edge a unit becomes a member
    of the neighbour's tree.
    """
    before = state
    for neighbor in list(state.edges):
        edge = state.edges[neighbor]
        if not edge.is_my_turn:
            continue
        at_hand, wants = (context.slot, edge.reach), edge.wants
        if context.at_slot or edge.considered != at_hand:
            pair = _better_pair(state, context, edge)
            if context.at_slot and pair is not None:
                state = _exchanged(state, context, edge, pair)
                edge = state.edges[neighbor]
            wants = pair is not None and not context.at_slot
        edge = replace(edge, considered=at_hand, wants=wants)
        if not wants:
            offered = offerable(state, context, neighbor)
            edge = edge.handed_over(offered, _to_release(context, edge, offered))
        state = _with_edge(state, edge)
    return replace(before, edges=state.edges, tree_id=state.tree_id, ready=state.ready, asks_id=state.asks_id)


def _with_edge(state: NodeState, edge: Edge) -> NodeState:
    return replace(state, edges={**state.edges, edge.neighbor_id: edge})


def _exchanged(state: NodeState, context: Situation, edge: Edge, pair: Robots) -> NodeState:
    """Return the state with `pair` shared instead of the present pair, which the neighbour keeps."""
    state = _with_edge(state, replace(edge, pair=pair))
    if state.is_member:
        return state
    tree = context.peers.newest[edge.neighbor_id].tree
    return replace(state, tree_id=tree.tree_id, ready=tree.ready, asks_id=NO_ID)


def _better_pair(state: NodeState, context: Situation, edge: Edge) -> Robots | None:
    """Return the pair that should replace the present one, or None if no pair is better."""
    neighbor = context.peers.newest[edge.neighbor_id]
    ours = state.controlled - edge.pair
    within_view = context.visible & (neighbor.near(context.settings.radius) | edge.to_release)
    return choose_pair(
        context.settings.share,
        context.shape,
        candidates=frozenset((edge.pair | edge.reach) & neighbor.controlled & within_view - ours),
        distances=context.distances,
        present=edge.pair,
        theirs=neighbor.report.controlled_ids,
        ours=np.array(sorted(ours), dtype=np.int64),
        to_take=edge.to_release,
        to_leave=edge.pair & edge.releasing,
        gain=context.settings.gain,
    )


def _to_release(context: Situation, edge: Edge, offered: Robots) -> Robots:
    """Return the offered robots that leave the unit's view and that the neighbour sees inside its radius.

    Return none if the unit could take none of the neighbour's robots in return: the pair would only
    alternate.
    """
    neighbor = context.peers.newest[edge.neighbor_id]
    near = neighbor.near(context.settings.radius)
    if len((neighbor.controlled - neighbor.paired) & context.visible & near) < 2:
        return NO_ROBOTS
    leaving = context.settings.radius * (1 + context.settings.hysteresis)
    return frozenset(r for r in offered & near if context.distances.get(r, np.inf) > leaving)
