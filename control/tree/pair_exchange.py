"""A unit's turn on an edge: exchange the pair if that is worth while, then hand the turn over."""

import numpy as np

from skyherd.control.tree.edge import NO_ROBOTS, Edge, Robots
from skyherd.control.tree.node_state import NodeState
from skyherd.control.tree.pair_selection import choose_pair
from skyherd.messages import NO_ID


def take_turns(unit: NodeState, time_s: float, at_slot: bool) -> None:
    """Take the turn on each edge where it is the unit's.

    A unit that has nothing to change hands the turn over at once; else it waits for the next slot, changes
    the pair there if that is still better, and hands over. It looks again only in a new slot or with new
    robots in reach.
    """
    for edge in unit.edges.values():
        if not edge.mine:
            continue
        at_hand = (unit.slot, edge.reach)
        if at_slot:
            edge.wants, pair = False, _better_pair(unit, edge)
            if pair is not None:
                _exchange(unit, edge, pair)
        elif edge.considered != at_hand:
            edge.wants = _better_pair(unit, edge) is not None
        edge.considered = at_hand
        if not edge.wants:
            offered = unit.offerable(edge.neighbor_id, time_s)
            edge.hand_over(offered, _unwanted(unit, edge, offered))


def _exchange(unit: NodeState, edge: Edge, pair: Robots) -> None:
    """Share `pair` instead of the present one, which the neighbour keeps; a first pair makes a member."""
    edge.pair = pair
    if not unit.is_member:
        tree = unit.heard.newest[edge.neighbor_id].tree
        unit.tree_id, unit.ready, unit.asks_id = tree.tree_id, tree.ready, NO_ID


def _better_pair(unit: NodeState, edge: Edge) -> Robots | None:
    """The pair to exchange the present one for, if any is better."""
    there = unit.heard.newest[edge.neighbor_id]
    ours = unit.controlled - edge.pair
    within_view = unit.visible & (there.near(unit.rule.radius) | edge.to_release)
    return choose_pair(
        unit.rule.share,
        unit.template,
        candidates=frozenset((edge.pair | edge.reach) & there.controlled & within_view - ours),
        distances=unit.distances,
        present=edge.pair,
        theirs=there.report.controlled_ids,
        ours=np.array(sorted(ours), dtype=np.int64),
        wanted=edge.to_release,
        unwanted=edge.pair & edge.releasing,
        gain=unit.rule.gain,
    )


def _unwanted(unit: NodeState, edge: Edge, offered: Robots) -> Robots:
    """Of the robots lent those that leave the unit's view and that the neighbour sees well.

    None, if it could take none of the neighbour's in return: the pair would only change about.
    """
    there = unit.heard.newest[edge.neighbor_id]
    near = there.near(unit.rule.radius)
    if len((there.controlled - there.paired) & unit.visible & near) < 2:
        return NO_ROBOTS
    leaving = unit.rule.radius * (1 + unit.rule.hysteresis)
    return frozenset(r for r in offered & near if unit.distances.get(r, np.inf) > leaving)
