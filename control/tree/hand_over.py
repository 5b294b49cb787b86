"""Hand-over of a robot between the own sets of two units: announced, accepted, settled, done in one slot.

A robot that left the view of its unit, and that the unit cannot follow, should go to a unit that sees it.
Exchanges of pairs alone cannot achieve this, since every unit keeps its number of robots (docs/topology.md).
Two sets must therefore change at one instant, the start of a slot:

- the unit announces the robot and the member that sees it nearest to its image centre;
- that member accepts as long as it sees the robot;
- the unit receives the acceptance and chooses the slot, late enough for the message to arrive before it;
- at their first images in that slot the unit drops the robot, and the other one makes it its own.

Every report repeats the complete state. An offer that is not accepted is withdrawn; a settled one is not. If
message loss delays the slot number until the slot ends, the robot is uncontrolled until a unit adopts it
(`orphans`).
"""

from dataclasses import replace

from skyherd.control.topology.slots import slot_at
from skyherd.control.tree.node_state import HandOver, NodeState, Situation
from skyherd.control.tree.offers import lost, undisputed
from skyherd.control.tree.peer_reports import PeerReport
from skyherd.messages import NO_SLOT

LEAD = 0.5
"""Minimum time from settling a hand-over to the start of its slot, in slots. Chosen: five images at five a
second, so that losing all reports is unlikely; a robot waits at most half a slot longer."""


def take(state: NodeState, context: Situation) -> NodeState:
    """Accept robots that other members want to hand over, and take settled ones in their slot.

    A robot is not taken if a third unit claims it by then, or if its slot was over when the unit was
    informed: others may have adopted it since.
    """
    handing = [peer for peer in context.members if peer.tree.handed_ids.size]
    if not state.is_member or not (handing or state.taking or state.accepted):
        return state
    taking = dict(state.taking)
    for peer in context.news:
        settled = _handed_to(context.unit_id, peer)
        taking |= {robot: (peer.unit_id, slot) for robot, slot in settled.items() if slot >= context.slot}
    due = {robot: giver for robot, (giver, slot) in taking.items() if slot <= context.slot}
    own = state.own | {
        robot for robot, giver in due.items() if not _is_claimed(context, robot, excluding=giver)
    }
    handed = frozenset[int]().union(*(_handed_to(context.unit_id, peer) for peer in handing))
    return replace(
        state,
        own=own,
        taking={robot: settled for robot, settled in taking.items() if robot not in due},
        accepted=(handed & context.visible) - state.controlled,
    )


def give(state: NodeState, context: Situation) -> NodeState:
    """Hand robots that left the view to members that see them, and drop robots whose slot has come.

    Robots that are promised to a neighbour are kept until its turn is over.
    """
    if not (context.at_slot or state.giving):
        return state
    own = state.own - {r for r, hand_over in state.giving.items() if NO_SLOT < hand_over.slot <= context.slot}
    giving = {r: hand_over for r, hand_over in state.giving.items() if r in own}
    givable = lost(state, context) & own
    for robot, hand_over in list(giving.items()):
        if hand_over.slot != NO_SLOT:
            continue
        if robot in context.peers.newest[hand_over.to_id].tree.accepted_ids:
            giving[robot] = replace(hand_over, slot=_slot_ahead(context))
        elif context.at_slot or robot not in givable:
            del giving[robot]
    if context.at_slot:
        for robot in (givable & undisputed(state, context)) - giving.keys() - state.offered():
            to_id = _nearest_member(context, robot)
            if to_id is not None:
                giving[robot] = HandOver(to_id)
    return replace(state, own=own, giving=giving)


def _handed_to(unit_id: int, peer: PeerReport) -> dict[int, int]:
    """Return the slot of each robot that a unit hands to `unit_id`; `NO_SLOT` until it is settled."""
    tree = peer.tree
    rows = zip(tree.handed_ids.tolist(), tree.handed_to_ids.tolist(), tree.handed_slots.tolist(), strict=True)
    return {robot: slot for robot, to_id, slot in rows if to_id == unit_id}


def _is_claimed(context: Situation, robot: int, excluding: int) -> bool:
    """Return whether a member besides the unit `excluding` reports control of a robot."""
    return any(robot in peer.controlled for peer in context.members if peer.unit_id != excluding)


def _slot_ahead(context: Situation) -> int:
    """Return the first slot that begins more than `LEAD` slots from now."""
    return slot_at(context.time_s + LEAD * context.settings.dwell_s, context.settings.dwell_s) + 1


def _nearest_member(context: Situation, robot: int) -> int | None:
    """Return the member that sees a robot nearest to its image centre, within the radius; lowest in ties."""
    seen = ((peer.distances.get(robot, context.settings.radius), peer.unit_id) for peer in context.members)
    inside = [(distance, unit_id) for distance, unit_id in seen if distance < context.settings.radius]
    return min(inside)[1] if inside else None
