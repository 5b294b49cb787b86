"""A unit's standing in the tree: its own robots, its edges, and what it knows."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.control.topology.safety_radius import centre_distances
from skyherd.control.tree.edge import NO_ROBOTS, NO_TURN, Edge, Robots
from skyherd.control.tree.peer_reports import PeerReports
from skyherd.messages import NO_ID, Detections

Share = Literal["leverage", "nearest"]


@dataclass(frozen=True)
class TreeRule:
    """Settings of the protocol (control/tree/protocol.py).

    Attributes:
        share: which pair two neighbours share.
        radius: robots are given and taken inside this distance, in halves of the image's shorter side.
        hysteresis: a unit wishes to lose a robot outside `radius (1 + hysteresis)`.
        dwell_s: sets change at multiples of this, but for succession.
        gain: a new pair must be better by this factor.
        firm: while an edge binds at a rate below this, its units fly to see robots that bind it better.
        silence_s: a unit that was not heard for so long is dead, a robot not seen for so long is missing.
        patience_s: robots move after this even if some unit or robot has not been found.
    """

    share: Share = "leverage"
    radius: float = 0.92
    hysteresis: float = 0.06
    dwell_s: float = 2.0
    gain: float = 1.25
    firm: float = 0.2
    silence_s: float = 3.0
    patience_s: float = 60.0


@dataclass
class NodeState:
    """All that a unit's part in the protocol goes by.

    Attributes:
        rule: settings.
        template: the whole shape.
        heard: the other units' reports.
        unit_id: the unit itself, once it has seen an image.
        since_s: when it saw the first one.
        own: robots that only this unit controls.
        edges: by neighbour.
        tree_id: the tree it belongs to, or NO_ID.
        asks_id: the unit that it asks to admit it, or to found the tree, or NO_ID,
        ask_turn: and the turn at which it expects the edge to begin.
        ready: whether the tree is known to be complete, so that robots may move.
        slot: the dwell time that it is in, counted on the common clock.
        distances: of the robots seen now from the image centre.
        seen_s: when each robot was seen last.
        held_s: since when the unit controls each robot of its set.
    """

    rule: TreeRule
    template: Template
    heard: PeerReports
    unit_id: int = NO_ID
    since_s: float = np.inf
    own: set[int] = field(default_factory=set)
    edges: dict[int, Edge] = field(default_factory=dict)
    tree_id: int = NO_ID
    asks_id: int = NO_ID
    ask_turn: int = NO_TURN
    ready: bool = False
    slot: int = -1
    distances: dict[int, float] = field(default_factory=dict)
    seen_s: dict[int, float] = field(default_factory=dict)
    held_s: dict[int, float] = field(default_factory=dict)

    @property
    def controlled(self) -> set[int]:
        """S_j^c: the unit's own robots and the pairs of its edges."""
        return self.own.union(*(edge.pair for edge in self.edges.values()))

    @property
    def is_member(self) -> bool:
        """Whether the unit belongs to a tree."""
        return self.tree_id != NO_ID

    @property
    def visible(self) -> set[int]:
        """Robots seen inside the radius."""
        return {robot for robot, distance in self.distances.items() if distance < self.rule.radius}

    def look(self, seen: Detections) -> bool:
        """Take in an image; whether it is the first one of a slot."""
        self.unit_id, self.since_s = seen.unit_id, min(self.since_s, seen.time_s)
        self.distances = dict(zip(seen.ids.tolist(), centre_distances(seen).tolist(), strict=True))
        self.seen_s.update(dict.fromkeys(self.distances, seen.time_s))
        slot, before = int(np.floor(seen.time_s / self.rule.dwell_s + 1e-9)), self.slot
        self.slot = slot
        return slot != before

    def unseen_s(self, robot: int, time_s: float) -> float:
        """How long a robot has not been seen; counted from now on if it never was."""
        return time_s - self.seen_s.setdefault(robot, time_s)

    def lost(self, time_s: float) -> set[int]:
        """Own robots that went out of view: seen since the unit has them, and not for a silence.

        Those that it has not seen since they are its own it has inherited, and flies to where they are.
        """
        return {
            robot
            for robot in self.own
            if self.seen_s.get(robot, -np.inf) > self.held_s.get(robot, time_s)
            and time_s - self.seen_s[robot] > self.rule.silence_s
        }

    def offered(self, but: int = NO_ID) -> set[int]:
        """Robots promised to neighbours, but for one of them."""
        return set().union(*(edge.offered for unit, edge in self.edges.items() if unit != but))

    def undisputed(self, time_s: float) -> set[int]:
        """Own robots that no member claims, by a word of each since the unit has them.

        Others may have adopted or inherited them at the same time. Two units can settle that while the robots
        are their own (control/tree/orphans.py), and no more once they share them with third ones.
        """
        members = self.heard.members(time_s)
        known_s = min((heard.report.time_s for heard in members), default=np.inf)
        free = self.own - self.heard.claimed(time_s)
        return {robot for robot in free if self.held_s.get(robot, time_s) <= known_s}

    def askers(self, time_s: float) -> set[int]:
        """Units that ask this one to be admitted."""
        asking = (heard for heard in self.heard.fresh(time_s) if not heard.is_member)
        return {heard.report.unit_id for heard in asking if heard.tree.asks_id == self.unit_id}

    def offerable(self, unit: int, time_s: float) -> Robots:
        """Own robots, undisputed and in view of late, that a unit sees and that are lent to nobody else.

        Robots that several neighbours see, or units that ask to become neighbours, go to one after the other,
        slot by slot, two by two: so none is left out, and none gets a robot alone, which makes no pair. Those
        that have no pair yet come first.
        """
        free = self.undisputed(time_s).intersection(self.heard.seen_by(unit)) - self.offered(but=unit)
        free -= self.lost(time_s)
        newcomers = self.askers(time_s) | {other for other, edge in self.edges.items() if not edge.pair}
        sharers = {
            other: self.heard.seen_by(other) for other in sorted(newcomers | self.edges.keys() | {unit})
        }
        offered = set()
        for rank, robot in enumerate(sorted(self.own)):
            if robot not in free:
                continue
            seeing = [other for other, seen in sharers.items() if robot in seen]
            first = [other for other in seeing if other in newcomers] or seeing
            if first[(rank // 2 + self.slot) % len(first)] == unit:
                offered.add(robot)
        return frozenset(offered)

    def open_edge(
        self, neighbor: int, time_s: float, turn: int, pair: Robots, offered: Robots = NO_ROBOTS
    ) -> None:
        """A new edge, at the given turn."""
        self.edges[neighbor] = Edge(self.unit_id, neighbor, time_s, turn, pair, offered)

    def resign(self) -> None:
        """Leave the tree, to join it anew."""
        self.edges, self.own, self.ready = {}, set(), False
        self.tree_id = self.asks_id = NO_ID
