"""Complete tree of units, assembled from the last status of each unit, for pictures and reports.

No unit knows the whole tree. Statuses arrive at different times, so that the two ends of an edge may
disagree for a while. The end with more turns is then right.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from skyherd.loop import Step
from skyherd.messages import NO_ID
from skyherd.messages.tree_status import TreeStatus

Ends = tuple[int, int]
"""Two units, the lower one first."""


@dataclass(frozen=True)
class Link:
    """An edge of the tree, by the newer status of its two ends.

    Attributes:
        ends: its units.
        turn: turns taken so far.
        pair: ids of the robots that its units share, ascending; empty while the edge is granted but not yet
            used.
        is_mutual: True if both ends name it.
    """

    ends: Ends
    turn: int
    pair: tuple[int, ...]
    is_mutual: bool

    @property
    def holder(self) -> int:
        """Unit that may change the pair now: after an even number of turns the lower one."""
        return self.ends[self.turn % 2]


@dataclass(frozen=True)
class TreeSnapshot:
    """The tree at one instant.

    Attributes:
        links: edges by their ends.
        members: units that belong to the tree.
        unjoined: living units that do not.
        dead: units in an outage.
        asks: unit from which each unjoined unit requests admission, if any.
        heirs: successor of each unit.
        missing_ids: robots that their units have not seen for long.
        ready: True if a unit knows that the tree is complete, so that robots may move.
    """

    links: Mapping[Ends, Link]
    members: frozenset[int]
    unjoined: frozenset[int]
    dead: frozenset[int]
    asks: Mapping[int, int]
    heirs: Mapping[int, int]
    missing_ids: frozenset[int]
    ready: bool


def tree_snapshot(statuses: Mapping[int, TreeStatus], dead: Iterable[int] = ()) -> TreeSnapshot:
    """Assemble the tree from the last status of each living unit, and the units in an outage."""
    members = frozenset(unit for unit, status in statuses.items() if status.tree_id != NO_ID)
    return TreeSnapshot(
        links=_links(statuses),
        members=members,
        unjoined=frozenset(statuses) - members,
        dead=frozenset(dead),
        asks={unit: status.asks_id for unit, status in statuses.items() if status.asks_id != NO_ID},
        heirs={unit: status.heir_id for unit, status in statuses.items() if status.heir_id != NO_ID},
        missing_ids=frozenset(robot for status in statuses.values() for robot in status.missing_ids.tolist()),
        ready=any(status.ready for status in statuses.values()),
    )


def _links(statuses: Mapping[int, TreeStatus]) -> dict[Ends, Link]:
    links: dict[Ends, Link] = {}
    for unit, status in sorted(statuses.items()):
        rows = zip(status.neighbor_ids.tolist(), status.turns.tolist(), status.pairs.tolist(), strict=True)
        for neighbor, turn, pair in rows:
            ends = min(unit, neighbor), max(unit, neighbor)
            own = Link(
                ends=ends,
                turn=turn,
                pair=tuple(sorted(robot for robot in pair if robot != NO_ID)),
                is_mutual=False,
            )
            other = links.get(ends)
            newer = own if other is None or own.turn > other.turn else other
            links[ends] = Link(ends=ends, turn=newer.turn, pair=newer.pair, is_mutual=other is not None)
    return links


@dataclass
class TreeHistory:
    """Last status of each unit, since a unit has no new one at most steps."""

    _statuses: dict[int, TreeStatus] = field(default_factory=dict, init=False)

    def add(self, step: Step, dead: Iterable[int]) -> TreeSnapshot | None:
        """Return the tree after a step with these units in an outage; None without a tree."""
        for unit, frame in step.frames.items():
            if (status := frame.decision.report.tree) is not None:
                self._statuses[unit] = status
        for unit in dead:
            self._statuses.pop(unit, None)
        return tree_snapshot(self._statuses, dead) if self._statuses else None
