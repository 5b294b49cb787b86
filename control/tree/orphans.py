"""Adoption of uncontrolled robots, and resolution of robots that two units claim."""

from dataclasses import replace

import numpy as np

from skyherd.control.tree.node_state import NodeState, Situation


def yield_claims(state: NodeState, context: Situation) -> NodeState:
    """Drop own robots that a lower unit controls as well, or that an edge of other units shares.

    A report from before this unit had the robot is no claim: the sender may have given the robot away since.
    """
    if state.own.isdisjoint(context.claimed):
        return state
    own = state.own
    for peer in context.members:
        claimed = peer.controlled if peer.unit_id < context.unit_id else peer.paired
        own -= {robot for robot in own & claimed if state.held_s.get(robot, context.time_s) <= peer.time_s}
    return replace(state, own=own)


def adopt_orphans(state: NodeState, context: Situation) -> NodeState:
    """Adopt robots in view that no member controls.

    The unit waits half a dwell time, so that reports in transit have arrived. The robot then becomes the own
    of the member that last reported it nearest to its image centre; ties go to the lower unit. A robot passes
    between units by being shared for at least a slot. It is therefore uncontrolled only if all members report
    so for this slot or the one before.
    """
    if not state.is_member:
        return state
    orphans = context.distances.keys() - context.claimed - state.controlled
    since_s = {robot: state.orphaned_s.get(robot, context.time_s) for robot in orphans}
    reported_s = min((peer.time_s for peer in context.members), default=np.inf)
    adopted: set[int] = set()
    if context.at_slot and reported_s >= (context.slot - 1) * context.settings.dwell_s:
        waiting_s = context.settings.dwell_s / 2
        adopted = {
            robot
            for robot in orphans
            if context.time_s - since_s[robot] >= waiting_s and _is_nearest(state, context, robot)
        }
    return replace(state, own=state.own | adopted, orphaned_s=since_s, distances_before=context.distances)


def _is_nearest(state: NodeState, context: Situation, robot: int) -> bool:
    """Return whether no member reported the robot nearer than this unit did in its last image."""
    others = ((peer.distances.get(robot, np.inf), peer.unit_id) for peer in context.members)
    here = (state.distances_before.get(robot, np.inf), context.unit_id)
    return here <= min(others, default=(np.inf, context.unit_id))
