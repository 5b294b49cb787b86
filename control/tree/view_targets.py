"""Which robots a unit flies to see, besides those that it controls."""

import numpy as np

from skyherd.control.tree.node_state import NodeState
from skyherd.control.tree.pair_selection import firmer_pair
from skyherd.geometry import IntArray


def robots_sought(unit: NodeState, time_s: float) -> IntArray:
    """Robots, ascending, that a unit flies to see: to bind a weak edge firmly, or that its neighbour lost."""
    robots: set[int] = set()
    for edge in unit.edges.values():
        there = unit.heard.newest[edge.neighbor_id]
        lost = there.tree.missing_ids.tolist()
        robots.update(robot for robot in lost if unit.unseen_s(robot, time_s) < unit.rule.patience_s)
        if unit.rule.share == "leverage" and edge.pair and edge.pair <= there.controlled:
            robots |= firmer_pair(
                unit.template,
                edge.pair,
                candidates=(there.controlled - there.paired) - unit.controlled,
                theirs=there.controlled,
                ours=frozenset(unit.controlled - edge.pair),
                firm=unit.rule.firm,
                gain=unit.rule.gain,
            )
    return np.array(sorted(robots), dtype=np.int64)
