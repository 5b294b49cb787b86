"""Control sets that keep TC1-TC5 by agreement: each unit's own robots, and a pair on each edge of a tree.

Every robot is one unit's own or in the pair of one edge, and the edges form a tree; then TC1-TC5 hold
whatever the assignment is (docs/topology.md has the proofs). The assignment changes only

- by turns (`pair_exchange`, `edge`): a unit exchanges the pair of an edge, at a slot of the team's time. A
  robot goes from one unit to another by being shared in between. Every change is made by one unit alone, the
  one that has the turn, so that nothing has to be agreed on and nothing can be half agreed;
- by joining (`joining`): a unit asks a member of the tree, which grants an edge without a pair; the new unit
  takes the first pair in its first turn;
- by failover (`failover`): each unit names an heir among its neighbours. When the unit falls silent the heir
  takes its robots and edges; the other neighbours turn to the heir and have the first turn;
- by hand-over (`hand_over`): a robot that its unit lost from view becomes the own of one that sees it, with a
  slot that both have agreed on;
- by adoption (`orphans`): a robot that nobody controls becomes the own of the unit that sees it nearest to
  its centre;
- by repair (`orphans`, `partition`): robots that two units claim lose one of them, and of two trees, or two
  parts of one, all units but those of one leave and join again.

Turns and joining are safe however messages are lost, late, repeated or reordered, while every two units
receive a report of each other once in a silence: the protocol assumes that every unit can hear of every other
one, directly or by relay. Failover, hand-over and adoption rest on what was received. Should two units hold
one robot as their own, the higher one drops it; if it is in the pair of another edge, the unit that holds it
as its own does. Neither offers it before that is settled. A unit that learns that it was given up for dead
starts anew, and so does the smaller of two parts of the tree that lost one another (`partition`).

A unit's state is one value (`NodeState`). Each rule reads it and the unit's situation (time, view, reports)
and returns the next state; `TreeProtocol.choose` applies the rules in the order of `RULES`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.control.policy import Selection, SelectionPolicy
from skyherd.control.selection.safety_radius import centre_distances
from skyherd.control.topology.slots import slot_at
from skyherd.control.tree.failover import fail_over, name_heir
from skyherd.control.tree.hand_over import give, take
from skyherd.control.tree.joining import admit, join_tree, watch_growth
from skyherd.control.tree.node_state import NodeState, Situation, TreeRule
from skyherd.control.tree.orphans import adopt_orphans, yield_claims
from skyherd.control.tree.pair_exchange import receive_turns, use_turns
from skyherd.control.tree.partition import heal_partition, leave_for_lower_tree
from skyherd.control.tree.peer_reports import PeerReports
from skyherd.control.tree.view_targets import seek_robots
from skyherd.geometry import IntArray
from skyherd.messages import NO_ID, Detections, TreeStatus, UnitReport


def note_view(state: NodeState, now: Situation) -> NodeState:
    """Note the time, the slot, and which robots are in view.

    Without an image for a silence, or after its clock was set, a unit begins anew to look around.
    """
    is_used = now.time_s - state.imaged_s <= now.rule.silence_s
    return replace(
        state,
        imaged_s=now.time_s,
        since_s=state.since_s if is_used else now.time_s,
        slot=now.slot,
        seen_s={**state.seen_s, **dict.fromkeys(now.distances, now.time_s)},
    )


def note_holding(state: NodeState, now: Situation) -> NodeState:
    """Note since when the unit has had each robot of its set, and which own robots it has never seen."""
    never_seen = state.own - now.distances.keys() - state.seen_s.keys() - state.missed_since_s.keys()
    return replace(
        state,
        held_s={robot: state.held_s.get(robot, now.time_s) for robot in state.controlled},
        missed_since_s={**state.missed_since_s, **dict.fromkeys(never_seen, now.time_s)},
    )


Transition = Callable[[NodeState, Situation], NodeState]
"""A rule of the protocol: from a unit's state and situation to the next state.

Its calls of `replace` name the fields that it changes.
"""

RULES: tuple[tuple[Transition, str], ...] = (
    (note_view, "first: all other rules read when robots were seen"),
    (receive_turns, "before rules that read pairs: each edge is then known as its neighbour left it"),
    (leave_for_lower_tree, "before the tree is mended: a tree that gives way need not be"),
    (fail_over, "before claims and offers: what a dead neighbour had is settled first"),
    (heal_partition, "after failover: parts of the tree are told apart by the edges that are left"),
    (yield_claims, "before offers and adoption: both are made of what is left"),
    (admit, "before this unit's own turns: units that ask get robots before neighbours with a pair do"),
    (adopt_orphans, "after claims: what is adopted now can be offered in the turns of this image"),
    (take, "after claims: a robot that was just taken is none of those that were claimed before"),
    (give, "after admission: a robot that was just promised stays"),
    (join_tree, "after the rules for members: a founder begins to grant edges at its next image"),
    (use_turns, "after all that changes own robots: offers are made of those that stay own"),
    (watch_growth, "after turns: the tree grows by them, and is seen to have grown in the same image"),
    (name_heir, "after turns: only a neighbour with a pair can be the heir"),
    (seek_robots, "after turns: a pair that was just taken is not sought"),
    (note_holding, "last: it notes what all other rules have decided"),
)
"""All rules in the order in which they are applied, each with the reason for its place.

Each rule is safe by itself, so that TC3-TC5 hold in any order; the order makes a unit react in the image in
which it learns of something (tests/control/tree/test_rule_order.py shows what happens otherwise).
"""


@dataclass
class TreeProtocol(SelectionPolicy):
    """One unit's part in the protocol, as a selection policy.

    Attributes:
        rule: settings.
        rules: what is applied, in this order; tests replace it.
        state: after the last image.
        peers: reports received.
    """

    rule: TreeRule = field(default_factory=TreeRule)
    rules: tuple[tuple[Transition, str], ...] = RULES
    state: NodeState = field(default_factory=NodeState, init=False)
    peers: PeerReports = field(default_factory=PeerReports, init=False)

    def choose(
        self, seen: Detections, reports: Sequence[UnitReport], shape: Template, last: UnitReport | None
    ) -> Selection:
        """Apply all rules to one image and to the reports received."""
        now = self._situation(seen, reports, shape)
        for transition, _ in self.rules:
            self.state = self.state.after(transition(self.state, now))
        state = self.state
        return Selection(
            controlled_ids=_ascending(state.controlled),
            secure_ids=_ascending(state.controlled & now.visible),
            may_move=state.ready,
            sought_ids=_ascending(state.sought),
            searches=state.searches,
            tree_status=tree_status(state, now),
        )

    def _situation(self, seen: Detections, reports: Sequence[UnitReport], shape: Template) -> Situation:
        slot = slot_at(seen.time_s, self.rule.dwell_s)
        return Situation(
            rule=self.rule,
            shape=shape,
            unit_id=seen.unit_id,
            time_s=seen.time_s,
            slot=slot,
            at_slot=slot != self.state.slot,
            distances=dict(zip(seen.ids.tolist(), centre_distances(seen).tolist(), strict=True)),
            news=self.peers.take(reports),
            peers=self.peers,
        )


def tree_status(state: NodeState, now: Situation) -> TreeStatus:
    """What the unit's report says of the tree; missing are own robots that it has not seen for a silence."""
    edges = list(state.edges.values())
    offers = [(robot, edge.neighbor_id) for edge in edges for robot in sorted(edge.offered)]
    to_release = frozenset[int]().union(*(edge.releasing & edge.offered for edge in edges))
    hidden = state.own - now.distances.keys()
    missing = [robot for robot in hidden if state.unseen_s(robot, now.time_s) > now.rule.silence_s]
    return TreeStatus(
        tree_id=state.tree_id,
        asks_id=state.asks_id,
        ask_turn=state.ask_turn,
        heir_id=state.heir_id,
        ready=state.ready,
        neighbor_ids=np.array([edge.neighbor_id for edge in edges], dtype=np.int64),
        turns=np.array([edge.turn for edge in edges], dtype=np.int64),
        pairs=np.array([sorted(edge.pair) or [NO_ID, NO_ID] for edge in edges], dtype=np.int64),
        offered_ids=np.array([robot for robot, _ in offers], dtype=np.int64),
        offered_to_ids=np.array([neighbor for _, neighbor in offers], dtype=np.int64),
        to_release_ids=_ascending(to_release),
        missing_ids=_ascending(missing),
        handed_ids=np.array(list(state.giving), dtype=np.int64),
        handed_to_ids=np.array([hand_over.to_id for hand_over in state.giving.values()], dtype=np.int64),
        handed_slots=np.array([hand_over.slot for hand_over in state.giving.values()], dtype=np.int64),
        accepted_ids=_ascending(state.accepted),
    )


def _ascending(robots: Sequence[int] | frozenset[int]) -> IntArray:
    return np.array(sorted(robots), dtype=np.int64)
