"""Robots that a unit flies to see, besides its controlled robots.

Both units of an edge know each other's control set and the shape. They can therefore compute the pair of
robots with the fastest agreement of their two fits, even if they do not see these robots
(`skyherd.control.tree.pair_selection`). While the shared pair is weak, they fly to bring a better one into
view. The tree then exchanges the pair in an ordinary turn. They also search for robots that a neighbour has
lost from view. A unit moves aside for sought robots only while its own robots stay in view
(`skyherd.control.flight.keep_in_view`).

docs/topology.md has the measured effect on the convergence time.
"""

from dataclasses import replace

from skyherd.control.tree.node_state import NodeState, Situation
from skyherd.control.tree.pair_selection import stronger_pair


def seek_robots(state: NodeState, context: Situation) -> NodeState:
    """Select robots to bring into view at a slot: missing robots, and pairs that would strengthen weak edges.

    A neighbour reports own robots that it has not seen for a silence timeout. The unit searches for those
    that it saw itself, or began to search for, within its patience. It also searches for robots that no
    living member controls, such as those of units that died with all their neighbours, until a unit controls
    them. For a weak edge it computes the pair that would couple both units strongly, and flies to see it.
    """
    if not context.at_slot:
        return state
    robots = set(context.shape.members - context.claimed - state.controlled) if state.ready else set[int]()
    missed_since_s = dict(state.missed_since_s)
    for edge in state.edges.values():
        neighbor = context.peers.newest[edge.neighbor_id]
        missing = neighbor.tree.missing_ids.tolist()
        for robot in missing:
            if robot not in state.seen_s:
                missed_since_s.setdefault(robot, context.time_s)
        robots.update(r for r in missing if state.unseen_s(r, context.time_s) < context.settings.patience_s)
        if context.settings.share == "leverage" and edge.pair and edge.pair <= neighbor.controlled:
            robots |= stronger_pair(
                context.shape,
                edge.pair,
                candidates=(neighbor.controlled - neighbor.paired) - state.controlled,
                theirs=neighbor.controlled,
                ours=state.controlled - edge.pair,
                firm=context.settings.firm,
                gain=context.settings.gain,
            )
    return replace(state, sought=frozenset(robots), missed_since_s=missed_since_s)
