"""State of a unit in the tree protocol: part of its report to the other units.

`skyherd.control.tree` has the protocol; docs/topology.md explains it.
"""

from dataclasses import dataclass
from functools import cached_property

from skyherd.geometry import IntArray
from skyherd.messages.frozen_arrays import freeze, freeze_ids
from skyherd.messages.ids import NO_ID

NO_SLOT = -(2**53)
"""Placeholder for no slot. Derived: below the slot number of any clock, also one that counts from a future
epoch, and exact in JSON."""


@dataclass(frozen=True)
class TreeStatus:
    """State of one unit in the tree of units; its E edges are rows of arrays.

    Attributes:
        tree_id: number of the unit's tree, NO_ID without one. Where two trees meet, the one with the lower
            number remains.
        asks_id: the unit from which it requests an edge, to be admitted to the tree or to found it; NO_ID if
            none.
        ask_turn: the turn, one of its own, at which it expects that edge; distinguishes repeated requests.
        heir_id: the neighbour that takes over its robots and edges on failover, or NO_ID.
        ready: whether it knows the tree to be complete, so that robots may move.
        neighbor_ids: (E,) the unit at the other end of each edge.
        turns: (E,) number of turns taken on each edge; the lower unit of the two has the even turns.
        pairs: (E, 2) the two robots that each edge shares, NO_ID without a pair.
        offered_ids: (L,) robots of its own that a neighbour may take over in its next turn.
        offered_to_ids: (L,) the neighbour to which each of them is offered.
        to_release_ids: (W,) offered robots that the unit prefers to release.
        missing_ids: (M,) robots of its own that it has not seen for a long time.
        handed_ids: (H,) robots of its own that will become another unit's own.
        handed_to_ids: (H,) the unit to which each of them goes.
        handed_slots: (H,) the slot of each hand-over, the same for both units; NO_SLOT until the other unit
            has accepted it.
        accepted_ids: (A,) robots that it would take of those that other units want to hand over.

    Raises:
        MessageError: a shape is wrong or an id occurs twice.
    """

    tree_id: int
    asks_id: int
    ask_turn: int
    heir_id: int
    ready: bool
    neighbor_ids: IntArray
    turns: IntArray
    pairs: IntArray
    offered_ids: IntArray
    offered_to_ids: IntArray
    to_release_ids: IntArray
    missing_ids: IntArray
    handed_ids: IntArray
    handed_to_ids: IntArray
    handed_slots: IntArray
    accepted_ids: IntArray

    def __post_init__(self) -> None:
        edges = freeze_ids(self, "neighbor_ids")
        freeze(self, "turns", (edges,), integer=True)
        freeze(self, "pairs", (edges, 2), integer=True)
        offered = freeze_ids(self, "offered_ids")
        freeze(self, "offered_to_ids", (offered,), integer=True)
        freeze_ids(self, "to_release_ids")
        freeze_ids(self, "missing_ids")
        handed = freeze_ids(self, "handed_ids")
        freeze(self, "handed_to_ids", (handed,), integer=True)
        freeze(self, "handed_slots", (handed,), integer=True)
        freeze_ids(self, "accepted_ids")

    @cached_property
    def rows(self) -> dict[int, int]:
        """Row of the edge by neighbour."""
        return {neighbor: row for row, neighbor in enumerate(self.neighbor_ids.tolist())}

    @cached_property
    def paired(self) -> frozenset[int]:
        """All robots that the unit's edges share."""
        return frozenset(self.pairs.ravel().tolist()) - {NO_ID}
