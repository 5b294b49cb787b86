"""What a unit says of the tree it belongs to: part of its report to the other units."""

from dataclasses import dataclass
from functools import cached_property

from skyherd.geometry import IntArray
from skyherd.messages.frozen_arrays import freeze, freeze_ids

NO_ID = -1
"""Stands for no unit and no robot."""


@dataclass(frozen=True)
class TreeStatus:
    """A unit's standing in the tree of units, its edges as rows of arrays.

    Attributes:
        tree_id: the tree it belongs to, NO_ID if none; of two trees the one with the lower number stays.
        asks_id: the unit that it asks to admit it, or to found the tree, or NO_ID,
        ask_turn: and the turn, its own, at which it expects the edge: it tells one asking from the next.
        heir_id: the neighbour that takes over its robots and edges should it fall silent, or NO_ID.
        ready: whether it knows the tree to be complete, so that robots may move.
        neighbor_ids: (E,) the other end of each edge.
        turns: (E,) turns taken on each edge; the lower unit holds the even ones.
        pairs: (E, 2) the robots that each edge shares, NO_ID while it has none.
        lent_ids: (L,) robots of its own that a neighbour whose turn it is may take,
        lent_to_ids: (L,) and which neighbour.
        wished_ids: (W,) those of them that it would rather lose.
        missing_ids: (M,) robots of its own that it has not seen for long.
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

    def __post_init__(self) -> None:
        edges = freeze_ids(self, "neighbor_ids")
        freeze(self, "turns", (edges,), integer=True)
        freeze(self, "pairs", (edges, 2), integer=True)
        offered = freeze_ids(self, "offered_ids")
        freeze(self, "offered_to_ids", (offered,), integer=True)
        freeze_ids(self, "to_release_ids")
        freeze_ids(self, "missing_ids")

    @cached_property
    def rows(self) -> dict[int, int]:
        """The row of each edge, by its other end."""
        return {neighbor: row for row, neighbor in enumerate(self.neighbor_ids.tolist())}

    @cached_property
    def paired(self) -> frozenset[int]:
        """Robots in the pairs of the unit's edges."""
        return frozenset(self.pairs.ravel().tolist()) - {NO_ID}
