"""Robots that nobody controls find a unit; robots that two units claim lose one."""

from dataclasses import replace

import numpy as np

from skyherd.control.tree.node_state import NodeState, Situation


def yield_claims(state: NodeState, now: Situation) -> NodeState:
    """Drop own robots that a lower unit controls as well, or that an edge of other units shares.

    What a unit reported before this one had the robot is no claim: it may have given the robot away since.
    """
    if state.own.isdisjoint(now.claimed):
        return state
    own = state.own
    for peer in now.members:
        claimed = peer.controlled if peer.unit_id < now.unit_id else peer.paired
        own -= {robot for robot in own & claimed if state.held_s.get(robot, now.time_s) <= peer.time_s}
    return replace(state, own=own)


def adopt_orphans(state: NodeState, now: Situation) -> NodeState:
    """As a member: make robots one's own that are in view and that no member controls.

    After half a dwell time in which nobody took it, so that reports on their way have arrived, such a robot
    becomes the own of the member that sees it nearest to its image centre, by what all reported last; of
    equals, of the lower unit. A robot goes from hand to hand by being shared for a slot at least. So nobody
    has it only if that is what all members report of this slot or of the one before.
    """
    if not state.is_member:
        return state
    orphans = now.distances.keys() - now.claimed - state.controlled
    since_s = {robot: state.orphaned_s.get(robot, now.time_s) for robot in orphans}
    reported_s = min((peer.time_s for peer in now.members), default=np.inf)
    adopted: set[int] = set()
    if now.at_slot and reported_s >= (now.slot - 1) * now.rule.dwell_s:
        waiting_s = now.rule.dwell_s / 2
        adopted = {
            robot
            for robot in orphans
            if now.time_s - since_s[robot] >= waiting_s and _is_nearest(state, now, robot)
        }
    return replace(state, own=state.own | adopted, orphaned_s=since_s, distances_before=now.distances)


def _is_nearest(state: NodeState, now: Situation, robot: int) -> bool:
    """Whether no member reported to see the robot nearer than this unit did in its last image."""
    others = ((peer.distances.get(robot, np.inf), peer.unit_id) for peer in now.members)
    here = (state.distances_before.get(robot, np.inf), now.unit_id)
    return here <= min(others, default=(np.inf, now.unit_id))
