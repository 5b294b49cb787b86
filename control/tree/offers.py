"""Own robots that a unit may offer to a neighbour."""

import numpy as np

from skyherd.control.tree.edge import Robots
from skyherd.control.tree.node_state import NodeState, Situation


def undisputed(state: NodeState, context: Situation) -> Robots:
    """Return own robots that no member claims, by a report of each member since the unit has them.

    Other units may have adopted or inherited the same robots at the same time. Two units can settle that
    while the robots are their own (control/tree/orphans.py), but not once they share them with third units.
    """
    known_s = min((peer.time_s for peer in context.members), default=np.inf)
    unclaimed = state.own - context.claimed
    return frozenset(robot for robot in unclaimed if state.held_s.get(robot, context.time_s) <= known_s)


def lost(state: NodeState, context: Situation) -> Robots:
    """Return own robots that left the view: seen since the unit has them, and not for a silence timeout.

    Robots that the unit has not seen since they are its own were inherited. The unit flies to them.
    """
    return frozenset(
        robot
        for robot in state.own
        if state.seen_s.get(robot, -np.inf) > state.held_s.get(robot, context.time_s)
        and context.time_s - state.seen_s[robot] > context.settings.silence_s
    )


def offerable(state: NodeState, context: Situation, neighbor: int) -> Robots:
    """Return own robots to offer to a unit: undisputed, seen by both, promised or handed to no other unit.

    Robots that several neighbours or requesting units see are offered to one after the other, slot by slot
    and two by two. None is left out and none gets a single robot, which makes no pair. Units without a pair
    have priority.
    """
    free = undisputed(state, context).intersection(context.seen_by(neighbor))
    free -= state.offered(excluding=neighbor) | lost(state, context) | state.giving.keys()
    newcomers = context.askers | {other for other, edge in state.edges.items() if not edge.pair}
    sharers = {other: context.seen_by(other) for other in sorted(newcomers | state.edges.keys() | {neighbor})}
    offers = set()
    for rank, robot in enumerate(sorted(state.own)):
        if robot not in free:
            continue
        seeing = [other for other, seen in sharers.items() if robot in seen]
        first = [other for other in seeing if other in newcomers] or seeing
        if first[(rank // 2 + context.slot) % len(first)] == neighbor:
            offers.add(robot)
    return frozenset(offers)
