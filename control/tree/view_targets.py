"""Which robots a unit flies to see, besides those that it controls.

Both units of an edge know each other's control set and the shape. They can therefore compute which pair of
robots would make their two fits agree fastest, whether or not they see these robots
(`skyherd.control.tree.pair_selection`). While the pair that they share is weak, they fly to get a better one
into view, and the tree then exchanges the pair in an ordinary turn. They do the same for robots that a
neighbour has lost from view. A unit moves aside for robots that it seeks only as long as its own robots stay
in view (`skyherd.control.flight.keep_in_view`).

Three measures together brought the median time to convergence of 40 random missions from 62 s to 30 s: this
flight, the look around before the tree is founded, and the choice of the unit that sees most robots as its
founder (`skyherd.control.tree.joining`). docs/topology.md has the measurements.
"""

from dataclasses import replace

from skyherd.control.tree.node_state import NodeState, Situation
from skyherd.control.tree.pair_selection import firmer_pair


def seek_robots(state: NodeState, now: Situation) -> NodeState:
    """At a slot: choose robots to get into view: missing ones, and pairs that would bind weak edges firmly.

    A neighbour reports robots of its own that it has not seen for a silence; the unit looks for those that it
    saw itself, or began to look for, within its patience. Robots that no living member controls, as those of
    units that died with all their neighbours, it looks for until somebody has them. Both units of an edge
    know each other's control set and the shape, and so which pair would bind them firmly, seen or not; while
    theirs is weak they fly to see a better one.
    """
    if not now.at_slot:
        return state
    robots = set(now.shape.members - now.claimed - state.controlled) if state.ready else set[int]()
    missed_since_s = dict(state.missed_since_s)
    for edge in state.edges.values():
        neighbor = now.peers.newest[edge.neighbor_id]
        missing = neighbor.tree.missing_ids.tolist()
        for robot in missing:
            if robot not in state.seen_s:
                missed_since_s.setdefault(robot, now.time_s)
        robots.update(r for r in missing if state.unseen_s(r, now.time_s) < now.rule.patience_s)
        if now.rule.share == "leverage" and edge.pair and edge.pair <= neighbor.controlled:
            robots |= firmer_pair(
                now.shape,
                edge.pair,
                candidates=(neighbor.controlled - neighbor.paired) - state.controlled,
                theirs=neighbor.controlled,
                ours=state.controlled - edge.pair,
                firm=now.rule.firm,
                gain=now.rule.gain,
            )
    return replace(state, sought=frozenset(robots), missed_since_s=missed_since_s)
