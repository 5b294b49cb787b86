"""Detection and repair of partitions: of two trees, or disconnected parts, all except one rejoin."""

from dataclasses import replace

import numpy as np

from skyherd.control.tree.node_state import NodeState, Situation, resigned
from skyherd.messages import NO_ID


def leave_for_lower_tree(state: NodeState, context: Situation) -> NodeState:
    """Leave the tree if one with a lower number exists, so that one of two trees remains."""
    others = [peer.tree.tree_id for peer in context.news]
    return resigned(state) if any(NO_ID < tree_id < state.tree_id for tree_id in others) else state


def heal_partition(state: NodeState, context: Situation) -> NodeState:
    """Leave the tree if the unit's part of it has not been the largest one for a silence timeout.

    Two ends of an edge without reports from each other for long each continue without the other. When reports
    arrive again, one tree is in two parts without an edge in between. Every unit can compute its part from
    the edges that all members report. The units of the smaller part leave the tree one by one and rejoin it.
    Of equal parts the one with the lowest unit remains.
    """
    largest = min(_parts(state, context), key=lambda part: (-len(part), min(part)))
    if not state.is_member or context.unit_id in largest:
        return replace(state, minority_s=np.inf)
    since_s = min(state.minority_s, context.time_s)
    if context.time_s - since_s < context.settings.silence_s:
        return replace(state, minority_s=since_s)
    return replace(resigned(state), minority_s=np.inf)


def _parts(state: NodeState, context: Situation) -> list[set[int]]:
    """Return the parts of the tree: this unit and the known members, by their reported edges.

    Dead units at the ends of edges count as connections. Parts with an edge to a unit without reports,
    because it is dead or out of range, may be connected beyond it. They count as one part.
    """
    links = {peer.unit_id: set(peer.tree.rows) for peer in context.members}
    links[context.unit_id] = set(state.edges)
    known = set(links)
    for member, neighbors in list(links.items()):
        for neighbor in neighbors:
            links.setdefault(neighbor, set()).add(member)
    closed, beyond, unvisited = [], set(), set(links)
    while unvisited:
        part = _reached(unvisited.pop(), links)
        unvisited -= part
        if part <= known:
            closed.append(part)
        else:
            beyond |= part & known
    return closed + ([beyond] if beyond else [])


def _reached(start: int, links: dict[int, set[int]]) -> set[int]:
    """Return all units reachable along links."""
    part, ahead = {start}, [start]
    while ahead:
        new = links[ahead.pop()] - part
        part |= new
        ahead += new
    return part
