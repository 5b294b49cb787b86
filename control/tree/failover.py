"""When a neighbour falls silent: its heir takes over its robots and edges, the others turn to the heir.

Two adjoining units make one, so that what was a tree with one pair an edge still is.
"""

import numpy as np

from skyherd.control.tree.edge import NO_TURN, Edge, first_turn
from skyherd.control.tree.node_state import NodeState
from skyherd.control.tree.peer_reports import PeerReport
from skyherd.messages import NO_ID

GRACE = 2
"""Silences after which the other end of a new edge must know of it."""


def succeed(unit: NodeState, time_s: float) -> None:
    """Go on without neighbours that fell silent or left the tree; start anew if they gave up this unit."""
    for neighbor, edge in list(unit.edges.items()):
        if unit.edges.get(neighbor) is not edge:
            continue  # a burial or a resignation before was about it as well
        heard = unit.heard.newest.get(neighbor)
        last_s = max(edge.since_s, -np.inf if heard is None else heard.report.time_s)
        if time_s - last_s > unit.rule.silence_s:
            _bury(unit, edge, time_s)
        elif heard is not None and _is_left(unit, edge, heard):
            if heard.is_member and edge.pair:
                unit.resign()
            else:
                _bury(unit, edge, time_s)


def name_heir(unit: NodeState, heir_id: int) -> int:
    """The heir so far, or else the neighbour with fewest robots; for good, so that all know who it is."""
    if heir_id in unit.edges:
        return heir_id
    robots = {
        neighbor: len(unit.heard.newest[neighbor].controlled)
        for neighbor, edge in unit.edges.items()
        if edge.pair and neighbor in unit.heard.newest
    }
    return min(robots, key=lambda neighbor: (robots[neighbor], neighbor), default=NO_ID)


def _is_left(unit: NodeState, edge: Edge, heard: PeerReport) -> bool:
    """Whether the neighbour knows nothing of the edge, although it must by now: or it left the tree."""
    if unit.unit_id in heard.tree.rows:
        return False
    if not edge.pair:
        return heard.is_member or (heard.tree.asks_id, heard.tree.ask_turn) != (unit.unit_id, edge.turn)
    return not heard.is_member or heard.report.time_s > edge.since_s + GRACE * unit.rule.silence_s


def _bury(unit: NodeState, edge: Edge, time_s: float) -> None:
    """Close the edge to a unit that is gone; as its heir take over what was its, else turn to the heir."""
    del unit.edges[edge.neighbor_id]
    heard = unit.heard.bequest.get(edge.neighbor_id)
    if heard is None or not edge.pair:
        return
    heir = heard.tree.heir_id
    if heir == unit.unit_id or not unit.heard.alive(heir, time_s):
        unit.own |= edge.pair
        _inherit(unit, heard, time_s)
    elif heir in unit.edges:
        unit.own |= edge.pair
    else:
        unit.open_edge(heir, time_s, first_turn(time_s, unit.unit_id, heir), edge.pair)


def _inherit(unit: NodeState, dead: PeerReport, time_s: float) -> None:
    """Take the dead unit's robots, unless somebody else has them, and its other edges.

    The other ends know best which pairs they had: their first turn tells.
    """
    living = [
        heard.controlled for heard in unit.heard.fresh(time_s) if heard.report.unit_id != dead.report.unit_id
    ]
    unit.own |= dead.controlled - unit.controlled.union(*living)
    for neighbor, pair in zip(dead.tree.neighbor_ids.tolist(), dead.tree.pairs.tolist(), strict=True):
        if NO_ID not in pair and neighbor not in unit.edges and unit.heard.alive(neighbor, time_s):
            unit.open_edge(neighbor, time_s, NO_TURN, frozenset(pair))
