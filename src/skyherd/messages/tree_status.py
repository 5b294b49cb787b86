"""The state of a unit in the tree protocol: part of its report to the other units.

`skyherd.control.tree` has the protocol; docs/topology.md explains it.
"""

from dataclasses import dataclass
from functools import cached_property

from skyherd.geometry import IntArray
from skyherd.messages.frozen_arrays import freeze, freeze_ids
from skyherd.messages.ids import NO_ID

NO_SLOT = -(2**53)
"""Stands for no slot. Derived: below the number of any slot that a clock shows, also one that counts from a
time to come, and exact in JSON."""


@dataclass(frozen=True)
class TreeStatus:
    """The state of one unit in the tree of units; its E edges are rows of arrays.

    Attributes:
        tree_id: number of the tree that the unit belongs to, NO_ID if it belongs to none. Where two trees
            meet, the one with the lower number remains.
        asks_id: the unit that it asks for an edge, to be admitted to the tree or to found it; NO_ID if none.
        ask_turn: the turn, one of its own, at which it expects that edge; distinguishes repeated requests.
        heir_id: the neighbour that takes over its robots and edges if it falls silent, or NO_ID.
        ready: whether it knows the tree to be complete, so that robots may move.
        neighbor_ids: (E,) the unit at the other end of each edge.
        turns: (E,) number of turns taken on each edge; the lower unit of the two has the even turns.
        pairs: (E, 2) the two robots that each edge shares, NO_ID while it has none.
        offered_ids: (L,) robots of its own that a neighbour may take over in its next turn.
        offered_to_ids: (L,) the neighbour that each of them is offered to.
        to_release_ids: (W,) those of the offered robots that the unit prefers to give up.
        missing_ids: (M,) robots of its own that it has not seen for a long time.
        handed_ids: (H,) robots of its own that are to become another unit's own.
        handed_to_ids: (H,) the unit that each of them goes to.
        handed_slots: (H,) the slot with which it does, the same for both units; NO_SLOT before the other unit
            has accepted it.
        accepted_ids: (A,) robots that it would take of those that other units want to hand to it.

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
        """By neighbour, the row of the edge to it."""
        return {neighbor: row for row, neighbor in enumerate(self.neighbor_ids.tolist())}

    @cached_property
    def paired(self) -> frozenset[int]:
        """All robots that the unit's edges share."""
        return frozenset(self.pairs.ravel().tolist()) - {NO_ID}
