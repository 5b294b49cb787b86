"""State of a unit in the tree protocol, and its inputs at one image. All values are immutable."""

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.control.tree.edge import NO_ROBOTS, NO_TURN, Edge, Robots
from skyherd.control.tree.peer_reports import PeerReport, PeerReports
from skyherd.messages import NO_ID, NO_SLOT
from skyherd.messages.checks import check_numbers

PairRule = Literal["leverage", "nearest"]
"""Rule by which two neighbours choose the pair that they share."""


@dataclass(frozen=True)
class TreeSettings:
    """Settings of the protocol (control/tree/protocol.py).

    Attributes:
        share: rule that chooses the pair shared by two neighbours. `leverage` takes the pair with the fastest
            agreement of their fits (control/topology/convergence_rate.py). `nearest` takes the two robots
            nearest to the image centre (the paper's rule).
        radius: distance from the image centre inside which robots change hands, in halves of the image's
            shorter side.
        hysteresis: a unit prefers to release a robot outside `radius (1 + hysteresis)`.
        dwell_s: length of a slot. Pairs are exchanged, and robots adopted or handed over, at the first image
            of a slot.
        gain: factor by which a new pair must be better than the present one, so that noise has no effect.
        firm: rate of agreement of an edge, in units of the robots' gain k, below which its units fly to see
            robots that make a better pair.
        silence_s: time without a message after which a unit counts as dead. Also the time without a sighting
            after which a robot counts as missing.
        patience_s: time after which robots may move even if a unit or a robot has not been found.
    """

    share: PairRule = "leverage"
    radius: float = 0.85
    hysteresis: float = 0.06
    dwell_s: float = 2.0
    gain: float = 1.25
    firm: float = 0.2
    silence_s: float = 3.0
    patience_s: float = 60.0

    def __post_init__(self) -> None:
        check_numbers(
            self,
            positive=("radius", "dwell_s", "gain", "silence_s"),
            not_negative=("hysteresis", "firm", "patience_s"),
            endless=("patience_s",),
        )


@dataclass(frozen=True)
class Extent:
    """Size of the tree, as one unit knows it.

    Attributes:
        outside: known units that belong to no tree.
        held: robots that some unit controls.
    """

    outside: frozenset[int]
    held: Robots


@dataclass(frozen=True)
class HandOver:
    """Destination of an own robot in a hand-over (control/tree/hand_over.py).

    Attributes:
        to_id: the unit that will own the robot.
        slot: the slot at whose start ownership changes; `NO_SLOT` before that unit has accepted.
    """

    to_id: int
    slot: int = NO_SLOT


@dataclass(frozen=True)
class NodeState:
    """State of a unit in the protocol. Only `TreeProtocol` replaces it, by the results of its rules.

    Attributes:
        own: robots that only this unit controls.
        edges: the unit's edges, by neighbour.
        tree_id: the unit's tree, by the number of its founder, or `NO_ID`.
        asks_id: the unit that it asks for admission, or to found the tree, or `NO_ID`.
        ask_turn: the turn at which it expects the requested edge to begin.
        heir_id: the neighbour that takes over its robots and edges if it falls silent, or `NO_ID`.
        ready: True if the tree is known to be complete, so that robots may move.
        giving: own robots that it hands over to other units.
        taking: robots that are handed over to it: the unit that owns each, and the slot of the change.
        accepted: robots that it accepts among those offered for hand-over.
        searches: True if the unit has to search for units or robots that the tree lacks.
        sought: robots to bring into view, besides those that it controls.
        imaged_s: time of its last image.
        since_s: time of its first image, or of the first after a silence without images.
        slot: number of the slot of its last image.
        seen_s: time of the last sighting of each robot.
        missed_since_s: time since which each robot that it has never seen is known to be missing.
        held_s: time since which it has controlled each robot of its set.
        orphaned_s: time since which it has seen each robot that no member claims.
        distances_before: distances of the robots from the image centre in its last image as a member.
        minority_s: time since which its part of a divided tree has been the smaller one, or infinity.
        extent: size of the tree at the last image before the tree was complete.
        grew_slot: slot of the last growth of the tree.
        stalled: True if the tree stopped growing for a slot before it was complete.
    """

    own: Robots = NO_ROBOTS
    edges: Mapping[int, Edge] = field(default_factory=dict)
    tree_id: int = NO_ID
    asks_id: int = NO_ID
    ask_turn: int = NO_TURN
    heir_id: int = NO_ID
    ready: bool = False
    giving: Mapping[int, HandOver] = field(default_factory=dict)
    taking: Mapping[int, tuple[int, int]] = field(default_factory=dict)
    accepted: Robots = NO_ROBOTS
    searches: bool = False
    sought: Robots = NO_ROBOTS
    imaged_s: float = -np.inf
    since_s: float = np.inf
    slot: int = -1
    seen_s: Mapping[int, float] = field(default_factory=dict)
    missed_since_s: Mapping[int, float] = field(default_factory=dict)
    held_s: Mapping[int, float] = field(default_factory=dict)
    orphaned_s: Mapping[int, float] = field(default_factory=dict)
    distances_before: Mapping[int, float] = field(default_factory=dict)
    minority_s: float = np.inf
    extent: Extent | None = None
    grew_slot: int = 0
    stalled: bool = False

    @cached_property
    def controlled(self) -> Robots:
        """The control set S_j^c: the unit's own robots and the pairs of its edges."""
        return self.own.union(*(edge.pair for edge in self.edges.values()))

    @property
    def is_member(self) -> bool:
        """True if the unit belongs to a tree."""
        return self.tree_id != NO_ID

    def offered(self, excluding: int = NO_ID) -> Robots:
        """Return the robots promised to neighbours, except those promised to the unit `excluding`."""
        return NO_ROBOTS.union(*(edge.offered for unit, edge in self.edges.items() if unit != excluding))

    def after(self, new: "NodeState") -> "NodeState":
        """Return this state with the differing fields of `new`, or this object itself if none differs."""
        if new is self:
            return self
        changed: dict[str, Any] = {}
        for name in _FIELDS:
            before, after = getattr(self, name), getattr(new, name)
            if after is not before and after != before:
                changed[name] = after
        return replace(self, **changed) if changed else self

    def unseen_s(self, robot: int, time_s: float) -> float:
        """Return the time since a robot was last seen, s; if it was never seen, since it was first missed."""
        return time_s - self.seen_s.get(robot, self.missed_since_s.get(robot, time_s))


_FIELDS = tuple(field.name for field in fields(NodeState))
"""Names of the fields of a state."""


def resigned(state: NodeState) -> NodeState:
    """Return the state of a unit that leaves the tree in order to rejoin it."""
    return replace(
        state,
        own=NO_ROBOTS,
        edges={},
        ready=False,
        tree_id=NO_ID,
        asks_id=NO_ID,
        giving={},
        taking={},
        accepted=NO_ROBOTS,
    )


@dataclass(frozen=True)
class Situation:
    """Inputs of a unit's decisions at one image, besides its own state.

    Attributes:
        settings: settings of the protocol.
        shape: the whole template, under the robots' present roles.
        unit_id: the unit itself.
        time_s: time of the image.
        slot: number of the slot of the image.
        at_slot: True for the unit's first image in that slot.
        distances: distances of the robots in the image from its centre, in half images.
        news: reports that arrived since the last image.
        peers: the newest report of each other unit.
    """

    settings: TreeSettings
    shape: Template
    unit_id: int
    time_s: float
    slot: int
    at_slot: bool
    distances: Mapping[int, float]
    news: tuple[PeerReport, ...]
    peers: PeerReports

    @cached_property
    def visible(self) -> Robots:
        """Robots in the image inside the radius."""
        return frozenset(robot for robot, at in self.distances.items() if at < self.settings.radius)

    @cached_property
    def living(self) -> tuple[PeerReport, ...]:
        """Newest reports of the units that are not silent, in the order of the units."""
        newest = sorted(self.peers.newest.items())
        return tuple(peer for _, peer in newest if self.time_s - peer.time_s <= self.settings.silence_s)

    @cached_property
    def members(self) -> tuple[PeerReport, ...]:
        """Newest reports of the living units that belong to a tree."""
        return tuple(peer for peer in self.living if peer.is_member)

    @cached_property
    def claimed(self) -> Robots:
        """Robots that members report to control."""
        return NO_ROBOTS.union(*(peer.controlled for peer in self.members))

    @cached_property
    def askers(self) -> frozenset[int]:
        """Units that ask this one for admission, or to found the tree."""
        outside = (peer for peer in self.living if not peer.is_member)
        return frozenset(peer.unit_id for peer in outside if peer.tree.asks_id == self.unit_id)

    def heard_s(self, unit: int) -> float:
        """Return the time of the newest report of a unit; -inf without a report."""
        peer = self.peers.newest.get(unit)
        return -np.inf if peer is None else peer.time_s

    def is_alive(self, unit: int) -> bool:
        """Return True if a unit's newest report is not older than the silence timeout."""
        return self.time_s - self.heard_s(unit) <= self.settings.silence_s

    def seen_by(self, unit: int) -> AbstractSet[int]:
        """Return the robots that a unit last reported to see."""
        peer = self.peers.newest.get(unit)
        return NO_ROBOTS if peer is None else peer.distances.keys()
