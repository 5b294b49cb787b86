"""S_j^c of one unit as an assignment that keeps TC1-TC5: its own robots, and a pair on each edge of a tree.

Every robot is one unit's own or in the pair of one edge; the edges form a tree. Then TC1-TC5 hold whatever
the assignment is. It changes only

- by turns (control/tree/pair_exchange.py, edge.py): a unit exchanges the pair of an edge, at a slot of the
  common clock, a dwell time apart; a robot goes from one unit to another by being shared in between;
- by joining (control/tree/joining.py): a unit asks a member of the tree, which grants an edge without a pair;
  the new unit takes its first pair as its first turn;
- by succession (control/tree/failover.py): each unit names an heir among its neighbours. When it falls silent
  the heir takes its robots and its edges; the other neighbours turn to the heir and have the first turn;
- by adoption (control/tree/orphans.py): a robot that nobody controls becomes the own of the unit that sees it
  nearest to its image centre.

Turns and joining are safe however messages are lost, late, repeated or reordered, while every two units hear
each other once in a silence. Succession and adoption rest on what was heard: should two units hold one robot
the higher one drops it, and neither lends it before that is settled; a unit that learns that it was given up
for dead starts anew, and so does the smaller of two parts of the tree that lost one another
(control/tree/partition.py). docs/topology.md proves what holds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.control.topology.safety_radius import NO_ROBOTS
from skyherd.control.tree.failover import name_heir, succeed
from skyherd.control.tree.joining import Extent, admit, extent_of, is_complete, seek
from skyherd.control.tree.node_state import NodeState, TreeRule
from skyherd.control.tree.orphans import Orphans, disown, yield_claims
from skyherd.control.tree.pair_exchange import take_turns
from skyherd.control.tree.partition import PartitionWatch
from skyherd.control.tree.peer_reports import PeerReports
from skyherd.control.tree.view_targets import robots_sought
from skyherd.geometry import IntArray
from skyherd.messages import NO_ID, Detections, TreeStatus, UnitReport

STALLED = 1
"""Dwell times without growth after which units look around."""


@dataclass
class TreeProtocol:
    """One unit's part of the assignment.

    `searches` while the unit is to look around for what the tree lacks; `sought` are robots to get into view,
    with which it could bind the tree firmly.
    """

    rule: TreeRule
    template: Template
    unit: NodeState = field(init=False)
    searches: bool = field(default=False, init=False)
    sought: IntArray = field(default_factory=lambda: NO_ROBOTS, init=False)
    _orphans: Orphans = field(default_factory=Orphans, init=False)
    _cohesion: PartitionWatch = field(default_factory=PartitionWatch, init=False)
    _heir_id: int = field(default=NO_ID, init=False)
    _extent: Extent | None = field(default=None, init=False)
    _grew_slot: int = field(default=0, init=False)
    _stalled: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self.unit = NodeState(self.rule, self.template, PeerReports(self.rule.silence_s))

    @property
    def ready(self) -> bool:
        """Whether robots may move."""
        return self.unit.ready

    def update(self, seen: Detections, reports: Sequence[UnitReport]) -> IntArray:
        """S_j^c after an image, ascending, given the last report heard from each other unit."""
        unit, time_s = self.unit, seen.time_s
        at_slot = unit.look(seen)
        self._hear(reports)
        succeed(unit, time_s)
        self._cohesion.keep(unit, time_s)
        yield_claims(unit, time_s)
        if unit.is_member:
            admit(unit, time_s)
            self._orphans.adopt(unit, time_s, at_slot)
            if at_slot:
                disown(unit, time_s)
        else:
            seek(unit, time_s, at_slot)
        take_turns(unit, time_s, at_slot)
        if not unit.ready:
            self._deploy(time_s)
        self._heir_id = name_heir(unit, self._heir_id)
        if at_slot:
            self.sought = robots_sought(unit, time_s)
        unit.held_s = {robot: unit.held_s.get(robot, time_s) for robot in unit.controlled}
        return np.array(sorted(unit.held_s), dtype=np.int64)

    def secure(self, seen: Detections) -> IntArray:
        """Robots of the set that are seen inside the radius now."""
        return np.array(sorted(self.unit.controlled & self.unit.visible), dtype=np.int64)

    def reshape(self, template: Template) -> None:
        """Robots have exchanged places: which pairs bind best follows the new ones."""
        self.unit.template = template

    def word(self, time_s: float) -> TreeStatus:
        """What the unit says of its standing."""
        unit = self.unit
        edges = list(unit.edges.values())
        offered = [(robot, edge.neighbor_id) for edge in edges for robot in sorted(edge.offered)]
        to_release = set().union(*(edge.releasing & edge.offered for edge in edges))
        hidden = unit.own - unit.distances.keys()
        missing = [robot for robot in hidden if unit.unseen_s(robot, time_s) > self.rule.silence_s]
        return TreeStatus(
            tree_id=unit.tree_id,
            asks_id=unit.asks_id,
            ask_turn=unit.ask_turn,
            heir_id=self._heir_id,
            ready=unit.ready,
            neighbor_ids=np.array([edge.neighbor_id for edge in edges], dtype=np.int64),
            turns=np.array([edge.turn for edge in edges], dtype=np.int64),
            pairs=np.array([sorted(edge.pair) or [NO_ID, NO_ID] for edge in edges], dtype=np.int64),
            offered_ids=np.array([robot for robot, _ in offered], dtype=np.int64),
            offered_to_ids=np.array([neighbor for _, neighbor in offered], dtype=np.int64),
            to_release_ids=np.array(sorted(to_release), dtype=np.int64),
            missing_ids=np.array(sorted(missing), dtype=np.int64),
        )

    def note(self, time_s: float, own: UnitReport, reports: Sequence[UnitReport]) -> None:
        """V falls by itself where TC1-TC5 hold: nothing to watch."""

    def _deploy(self, time_s: float) -> None:
        """Watch the tree grow until it is complete; look around before it is begun, and where it stalls."""
        extent = extent_of(self.unit, time_s)
        begun = self.unit.is_member or bool(self.unit.heard.members(time_s))
        if extent != self._extent or not begun:
            self._extent, self._grew_slot = extent, self.unit.slot
        self._stalled = self._stalled or self.unit.slot - self._grew_slot >= STALLED
        self.unit.ready = is_complete(self.unit, extent, time_s)
        self.searches = not self.unit.ready and (self._stalled or not begun)

    def _hear(self, reports: Sequence[UnitReport]) -> None:
        """Take the turns that are handed over; of two trees the one with the lower number stays."""
        unit = self.unit
        for heard in unit.heard.take(reports):
            edge = unit.edges.get(heard.report.unit_id)
            if edge is not None:
                before = edge.pair
                edge.hear(heard.report)
                unit.own = (unit.own | (before - edge.pair)) - edge.pair
            if NO_ID < heard.tree.tree_id < unit.tree_id:
                unit.resign()
