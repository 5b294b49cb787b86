"""Control sets that satisfy TC1-TC5 by agreement: each unit's own robots, and a pair on each edge of a tree.

Every robot is one unit's own or in the pair of one edge, and the edges form a tree. TC1-TC5 then hold for any
assignment (docs/topology.md has the proofs). The assignment changes only

- by turns (`pair_exchange`, `edge`): a unit exchanges the pair of an edge, at a slot of the team's time. A
  robot passes from one unit to another by being shared in between. Every change is made by one unit alone,
  the one with the turn, so that no agreement is needed;
- by joining (`joining`): a unit requests admission from a member of the tree, which grants an edge without a
  pair. The new unit takes the first pair in its first turn;
- by failover (`failover`): each unit names an heir among its neighbours. When the unit's heartbeat stops, the
  heir takes its robots and edges. The other neighbours join the heir and have the first turn;
- by hand-over (`hand_over`): a robot that its unit lost from view becomes the own of one that sees it, in a
  slot that both have agreed on;
- by adoption (`orphans`): an uncontrolled robot becomes the own of the unit that sees it nearest to its
  centre;
- by repair (`orphans`, `partition`): a robot that two units claim loses one of them. Of two trees, or two
  parts of one, all units except those of one leave and rejoin.

Turns and joining are safe under any message loss, delay, repetition and reordering. The condition is that
every two units receive a report of each other once per silence timeout. The protocol assumes that every unit
can receive reports of every other one, directly or by relay. Failover, hand-over and adoption depend on the
received reports. If two units hold one robot as their own, the higher one drops it. If the robot is in the
pair of another edge, the unit that holds it as its own drops it. Neither offers it before that is settled. A
unit that was declared dead rejoins, and so does the smaller of two separated parts of the tree (`partition`).

A unit's state is one value (`NodeState`). Each rule reads it and the unit's context (time, view, reports),
and returns its changes. `TreeProtocol.choose` applies the rules in the order of `RULES`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.control.policy import Selection, SelectionPolicy
from skyherd.control.topology.slots import slot_at
from skyherd.control.tree.failover import fail_over, name_heir
from skyherd.control.tree.hand_over import give, take
from skyherd.control.tree.joining import admit, join_tree, watch_growth
from skyherd.control.tree.node_state import NodeState, Situation, TreeSettings
from skyherd.control.tree.orphans import adopt_orphans, yield_claims
from skyherd.control.tree.pair_exchange import receive_turns, use_turns
from skyherd.control.tree.partition import heal_partition, leave_for_lower_tree
from skyherd.control.tree.peer_reports import PeerReports
from skyherd.control.tree.view_targets import seek_robots
from skyherd.geometry import IntArray
from skyherd.messages import NO_ID, Detections, TreeStatus, UnitReport


def note_view(state: NodeState, context: Situation) -> NodeState:
    """Record the time, the slot, and the robots in view.

    After a silence timeout without an image, or after a change of its clock, a unit searches again.
    """
    is_used = context.time_s - state.imaged_s <= context.settings.silence_s
    return replace(
        state,
        imaged_s=context.time_s,
        since_s=state.since_s if is_used else context.time_s,
        slot=context.slot,
        seen_s={**state.seen_s, **dict.fromkeys(context.distances, context.time_s)},
    )


def note_holding(state: NodeState, context: Situation) -> NodeState:
    """Record the time since which the unit has each robot of its set, and its own robots never seen."""
    never_seen = state.own - context.distances.keys() - state.seen_s.keys() - state.missed_since_s.keys()
    return replace(
        state,
        held_s={robot: state.held_s.get(robot, context.time_s) for robot in state.controlled},
        missed_since_s={**state.missed_since_s, **dict.fromkeys(never_seen, context.time_s)},
    )


Transition = Callable[[NodeState, Situation], NodeState]
"""A rule of the protocol: from a unit's state and situation to the next state.

Its calls of `replace` name the fields that it changes.
"""

RULES: tuple[tuple[Transition, str], ...] = (
    (note_view, "first: all other rules read the times at which robots were seen"),
    (receive_turns, "before rules that read pairs: each edge is then as its neighbour left it"),
    (leave_for_lower_tree, "before repairs: a tree that yields to another one needs none"),
    (fail_over, "before claims and offers: robots of a dead neighbour are settled first"),
    (heal_partition, "after failover: the remaining edges define the parts of the tree"),
    (yield_claims, "before offers and adoption: both use the remaining robots"),
    (admit, "before this unit's own turns: requesting units get robots before neighbours with a pair"),
    (adopt_orphans, "after claims: adopted robots can be offered in the turns of this image"),
    (take, "after claims: a robot just taken was not claimed before"),
    (give, "after admission: a robot just promised stays"),
    (join_tree, "after the rules for members: a founder begins to grant edges at its next image"),
    (use_turns, "after all changes of own robots: offers contain robots that stay own"),
    (watch_growth, "after turns: the tree grows by them, and growth is detected in the same image"),
    (name_heir, "after turns: only a neighbour with a pair can be the heir"),
    (seek_robots, "after turns: a pair just taken is not sought"),
    (note_holding, "last: it records the decisions of all other rules"),
)
"""All rules in the order of application, each with the reason for its place.

Each rule is safe by itself, so that TC3-TC5 hold in any order. The order makes a unit react in the image in
which it receives information. tests/control/tree/test_rule_order.py shows the effect of other orders.
"""


@dataclass
class TreeProtocol(SelectionPolicy):
    """Selection policy of one unit by the tree protocol.

    Attributes:
        settings: radii, times and thresholds of the protocol.
        rules: rules to apply, in this order; tests replace it.
        state: state after the last image.
        peers: received reports.
    """

    settings: TreeSettings = field(default_factory=TreeSettings)
    rules: tuple[tuple[Transition, str], ...] = RULES
    state: NodeState = field(default_factory=NodeState, init=False)
    peers: PeerReports = field(default_factory=PeerReports, init=False)

    def choose(
        self, seen: Detections, reports: Sequence[UnitReport], shape: Template, last: UnitReport | None
    ) -> Selection:
        """Apply all rules to one image and the received reports."""
        context = self._context(seen, reports, shape)
        for transition, _ in self.rules:
            self.state = self.state.after(transition(self.state, context))
        state = self.state
        return Selection(
            controlled_ids=_ascending(state.controlled),
            secure_ids=_ascending(state.controlled & context.visible),
            may_move=state.ready,
            sought_ids=_ascending(state.sought),
            searches=state.searches,
            tree_status=tree_status(state, context),
        )

    def _context(self, seen: Detections, reports: Sequence[UnitReport], shape: Template) -> Situation:
        slot = slot_at(seen.time_s, self.settings.dwell_s)
        return Situation(
            settings=self.settings,
            shape=shape,
            unit_id=seen.unit_id,
            time_s=seen.time_s,
            slot=slot,
            at_slot=slot != self.state.slot,
            distances=dict(zip(seen.ids.tolist(), seen.centre_distances.tolist(), strict=True)),
            news=self.peers.take(reports),
            peers=self.peers,
        )


def tree_status(state: NodeState, context: Situation) -> TreeStatus:
    """Return the part of the unit's report about the tree.

    Own robots unseen for a silence timeout are reported as missing.
    """
    edges = list(state.edges.values())
    offers = [(robot, edge.neighbor_id) for edge in edges for robot in sorted(edge.offered)]
    to_release = frozenset[int]().union(*(edge.releasing & edge.offered for edge in edges))
    hidden = state.own - context.distances.keys()
    missing = [
        robot for robot in hidden if state.unseen_s(robot, context.time_s) > context.settings.silence_s
    ]
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
