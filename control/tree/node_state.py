"""A unit's state in the tree protocol, and its situation at one image: values that no rule changes."""

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

Share = Literal["leverage", "nearest"]
"""How two neighbours choose the pair that they share."""


@dataclass(frozen=True)
class TreeSettings:
    """Settings of the protocol (control/tree/protocol.py).

    Attributes:
        share: which pair two neighbours share: the one that makes their fits agree fastest (`leverage`,
            control/topology/convergence_rate.py), or the two robots nearest to the image centre (`nearest`,
            the paper's rule).
        radius: robots are given and taken inside this distance from the image centre, in halves of the
            image's shorter side.
        hysteresis: a unit would rather lose a robot outside `radius (1 + hysteresis)`.
        dwell_s: length of a slot; pairs are exchanged, and robots adopted or handed over, at the first image
            of a slot.
        gain: a new pair must be better than the present one by this factor, so that noise exchanges nothing.
        firm: while an edge agrees at a lower rate than this (in units of the robots' gain k), its units fly
            to see robots that would make a better pair.
        silence_s: a unit from which nothing was received for so long counts as dead, and a robot that was not
            seen for so long as missing.
        patience_s: robots may move after this even if some unit or robot has not been found.
    """

    share: Share = "leverage"
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
    """How far the tree reaches, as one unit knows it.

    Attributes:
        outside: units that were heard of and belong to no tree.
        held: robots that some unit controls.
    """

    outside: frozenset[int]
    held: Robots


@dataclass(frozen=True)
class HandOver:
    """Where an own robot is to go (control/tree/hand_over.py).

    Attributes:
        to_id: the unit whose own it becomes.
        slot: the slot with which it does; `NO_SLOT` before that unit has accepted it.
    """

    to_id: int
    slot: int = NO_SLOT


@dataclass(frozen=True)
class NodeState:
    """A unit's part in the protocol. Only `TreeProtocol` replaces it, by what its rules return.

    Attributes:
        own: robots that only this unit controls.
        edges: by neighbour.
        tree_id: the tree that it belongs to, by the number of the founder, or `NO_ID`.
        asks_id: the unit that it asks to admit it, or to found the tree, or `NO_ID`.
        ask_turn: the turn at which it expects the edge that it asks for to begin.
        heir_id: the neighbour that takes over its robots and edges if it falls silent, or `NO_ID`.
        ready: whether the tree is known to be complete, so that robots may move.
        giving: own robots that are to become another unit's.
        taking: robots that are to become its own: the unit that has each, and the slot with which it does.
        accepted: robots that it would take of those that other units want to hand to it.
        searches: whether the unit is to look around for what the tree lacks.
        sought: robots to be got into view, besides those that it controls.
        imaged_s: time of its last image.
        since_s: time of its first image, or of the first after a silence without any.
        slot: number of the slot that its last image fell in.
        seen_s: when it saw each robot last.
        missed_since_s: since when it knows that a robot which it never saw is missing.
        held_s: since when it has controlled each robot of its set.
        orphaned_s: since when it has seen each robot that no member claims.
        distances_before: what it saw in the last image as a member: robots' distances from the image centre.
        minority_s: since when its part of a divided tree has been the smaller one; infinite if it is not.
        extent: the tree's reach at the last image before the tree was complete.
        grew_slot: slot in which the tree grew last.
        stalled: whether the tree stopped growing for a slot before it was complete.
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
        """S_j^c: the unit's own robots and the pairs of its edges."""
        return self.own.union(*(edge.pair for edge in self.edges.values()))

    @property
    def is_member(self) -> bool:
        """Whether the unit belongs to a tree."""
        return self.tree_id != NO_ID

    def offered(self, but: int = NO_ID) -> Robots:
        """Robots promised to neighbours, but for those promised to the unit `but`."""
        return NO_ROBOTS.union(*(edge.offered for unit, edge in self.edges.items() if unit != but))

    def after(self, new: "NodeState") -> "NodeState":
        """Return this state with the fields of `new` that differ; this very one if none does, as mostly."""
        if new is self:
            return self
        changed: dict[str, Any] = {}
        for name in _FIELDS:
            before, after = getattr(self, name), getattr(new, name)
            if after is not before and after != before:
                changed[name] = after
        return replace(self, **changed) if changed else self

    def unseen_s(self, robot: int, time_s: float) -> float:
        """How long a robot has not been seen; counted from when it was first missed if it never was."""
        return time_s - self.seen_s.get(robot, self.missed_since_s.get(robot, time_s))


_FIELDS = tuple(field.name for field in fields(NodeState))
"""Names of the fields of a state."""


def resigned(state: NodeState) -> NodeState:
    """Return the state of a unit that leaves the tree to join it anew."""
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
    """What a unit goes by at one image, besides its own state.

    Attributes:
        settings: settings.
        shape: the whole template, under the robots' present roles.
        unit_id: the unit itself.
        time_s: when the image was taken.
        slot: number of the slot that the image falls in.
        at_slot: whether it is the unit's first image in that slot.
        distances: of the robots in the image from its centre, in half images.
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
        """The newest reports of the units that are not silent, in the order of the units."""
        newest = sorted(self.peers.newest.items())
        return tuple(peer for _, peer in newest if self.time_s - peer.time_s <= self.settings.silence_s)

    @cached_property
    def members(self) -> tuple[PeerReport, ...]:
        """Those of them that belong to a tree."""
        return tuple(peer for peer in self.living if peer.is_member)

    @cached_property
    def claimed(self) -> Robots:
        """Robots that members report to control."""
        return NO_ROBOTS.union(*(peer.controlled for peer in self.members))

    @cached_property
    def askers(self) -> frozenset[int]:
        """Units that ask this one to be admitted, or to found the tree."""
        outside = (peer for peer in self.living if not peer.is_member)
        return frozenset(peer.unit_id for peer in outside if peer.tree.asks_id == self.unit_id)

    def heard_s(self, unit: int) -> float:
        """Time of the newest report of a unit; -inf if there is none."""
        peer = self.peers.newest.get(unit)
        return -np.inf if peer is None else peer.time_s

    def is_alive(self, unit: int) -> bool:
        """Whether a unit has been heard of within a silence."""
        return self.time_s - self.heard_s(unit) <= self.settings.silence_s

    def seen_by(self, unit: int) -> AbstractSet[int]:
        """Robots that a unit last reported to see."""
        peer = self.peers.newest.get(unit)
        return NO_ROBOTS if peer is None else peer.distances.keys()
