"""Robots that go from one unit's own to another's: announced, accepted, settled, and done with one slot.

A robot that left the view of its unit, and that the unit cannot follow, is better off with a unit that sees
it. No exchange of a pair can do that alone, since exchanges leave every unit as many robots as it has
(docs/topology.md). So two sets must change at one instant, the beginning of a slot:

- the unit names the robot, and the member that sees it nearest to its image centre;
- that member accepts as long as it sees the robot;
- the unit hears it and names the slot, which begins so much later that the news gets there before;
- at their first images in that slot the unit drops the robot, and the other one makes it its own.

Every report repeats all of it. What is not accepted is taken back, what is settled is not. Should the news of
the slot not arrive before the slot ends, nobody has the robot until somebody adopts it (`orphans`).
"""

from dataclasses import replace

from skyherd.control.topology.slots import slot_at
from skyherd.control.tree.node_state import HandOver, NodeState, Situation
from skyherd.control.tree.offers import lost, undisputed
from skyherd.control.tree.peer_reports import PeerReport
from skyherd.messages import NO_SLOT

LEAD = 0.5
"""Least time from settling a hand-over to the beginning of its slot, in slots. Chosen: five images of
a camera with five a second, so that hardly ever all reports of it are lost; a robot waits half a slot longer
for it than it otherwise would, at most."""


def take(state: NodeState, now: Situation) -> NodeState:
    """As a member: accept robots that others want to hand over, and take settled ones in their slot.

    A robot that a third unit claims by then is not taken, nor one whose slot was over before it was heard of:
    others may have adopted it since.
    """
    handing = [peer for peer in now.members if peer.tree.handed_ids.size]
    if not state.is_member or not (handing or state.taking or state.accepted):
        return state
    taking = dict(state.taking)
    for peer in now.news:
        settled = _handed_to(now.unit_id, peer)
        taking |= {robot: (peer.unit_id, slot) for robot, slot in settled.items() if slot >= now.slot}
    due = {robot: giver for robot, (giver, slot) in taking.items() if slot <= now.slot}
    own = state.own | {robot for robot, giver in due.items() if not _is_claimed(now, robot, but=giver)}
    handed = frozenset[int]().union(*(_handed_to(now.unit_id, peer) for peer in handing))
    return replace(
        state,
        own=own,
        taking={robot: settled for robot, settled in taking.items() if robot not in due},
        accepted=(handed & now.visible) - state.controlled,
    )


def give(state: NodeState, now: Situation) -> NodeState:
    """Hand robots that went out of view to members that see them, and drop those that are due.

    Robots that are promised to a neighbour are kept until its turn is over.
    """
    if not (now.at_slot or state.giving):
        return state
    own = state.own - {r for r, hand_over in state.giving.items() if NO_SLOT < hand_over.slot <= now.slot}
    giving = {r: hand_over for r, hand_over in state.giving.items() if r in own}
    givable = lost(state, now) & own
    for robot, hand_over in list(giving.items()):
        if hand_over.slot != NO_SLOT:
            continue
        if robot in now.peers.newest[hand_over.to_id].tree.accepted_ids:
            giving[robot] = replace(hand_over, slot=_slot_ahead(now))
        elif now.at_slot or robot not in givable:
            del giving[robot]
    if now.at_slot:
        for robot in (givable & undisputed(state, now)) - giving.keys() - state.offered():
            to_id = _nearest_member(now, robot)
            if to_id is not None:
                giving[robot] = HandOver(to_id)
    return replace(state, own=own, giving=giving)


def _handed_to(unit_id: int, peer: PeerReport) -> dict[int, int]:
    """By robot that a unit hands to `unit_id`: the slot, or `NO_SLOT` while that is not settled."""
    tree = peer.tree
    rows = zip(tree.handed_ids.tolist(), tree.handed_to_ids.tolist(), tree.handed_slots.tolist(), strict=True)
    return {robot: slot for robot, to_id, slot in rows if to_id == unit_id}


def _is_claimed(now: Situation, robot: int, but: int) -> bool:
    """Whether a member besides the unit `but` reports to control a robot."""
    return any(robot in peer.controlled for peer in now.members if peer.unit_id != but)


def _slot_ahead(now: Situation) -> int:
    """The first slot that begins more than `LEAD` slots from now."""
    return slot_at(now.time_s + LEAD * now.rule.dwell_s, now.rule.dwell_s) + 1


def _nearest_member(now: Situation, robot: int) -> int | None:
    """The member that sees a robot nearest to its image centre, within the radius; of equals the lowest."""
    seen = ((peer.distances.get(robot, now.rule.radius), peer.unit_id) for peer in now.members)
    inside = [(distance, unit_id) for distance, unit_id in seen if distance < now.rule.radius]
    return min(inside)[1] if inside else None
