"""Whether the tree holds together: of two trees, or of parts that lost one another, all but one join anew."""

from dataclasses import replace

import numpy as np

from skyherd.control.tree.node_state import NodeState, Situation, resigned
from skyherd.messages import NO_ID


def leave_for_lower_tree(state: NodeState, now: Situation) -> NodeState:
    """Leave a tree as soon as one with a lower number is heard of, so that of two trees one stays."""
    others = [peer.tree.tree_id for peer in now.news]
    return resigned(state) if any(NO_ID < tree_id < state.tree_id for tree_id in others) else state


def heal_partition(state: NodeState, now: Situation) -> NodeState:
    """Leave the tree if the unit's part of it has not been the largest one for a silence.

    Two ends of an edge that receive nothing from each other for long each go on without the other. Once they
    do again, one tree is in two parts with no edge in between. Every unit can tell its part by the edges that
    all members name. The units of the smaller part leave the tree one by one, and join it anew; of equal
    parts the one with the lowest unit stays.
    """
    largest = min(_parts(state, now), key=lambda part: (-len(part), min(part)))
    if not state.is_member or now.unit_id in largest:
        return replace(state, minority_s=np.inf)
    since_s = min(state.minority_s, now.time_s)
    if now.time_s - since_s < now.rule.silence_s:
        return replace(state, minority_s=since_s)
    return replace(resigned(state), minority_s=np.inf)


def _parts(state: NodeState, now: Situation) -> list[set[int]]:
    """The parts of the tree: this unit and the members heard of, by the edges that they name.

    Dead units that edges lead to count in between. Parts with an edge to a unit that is not heard of, because
    it is dead or out of range, may be one part beyond it, and count as one.
    """
    links = {peer.unit_id: set(peer.tree.rows) for peer in now.members}
    links[now.unit_id] = set(state.edges)
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
    """All units that a walk along links gets to."""
    part, ahead = {start}, [start]
    while ahead:
        new = links[ahead.pop()] - part
        part |= new
        ahead += new
    return part
