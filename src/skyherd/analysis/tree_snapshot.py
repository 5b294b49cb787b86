"""The tree of units as their last words tell it: for pictures and reports; no unit knows all of it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from skyherd.loop import Step
from skyherd.messages import NO_ID
from skyherd.messages.tree_status import TreeStatus

Ends = tuple[int, int]
"""Two units, the lower one first."""


@dataclass(frozen=True)
class Link:
    """An edge, by the newer word of its two ends.

    Attributes:
        ends: its units.
        turn: turns taken so far.
        pair: the robots that it shares, ascending; none while it is but granted.
        is_mutual: whether both ends name it.
    """

    ends: Ends
    turn: int
    pair: tuple[int, ...]
    is_mutual: bool

    @property
    def holder(self) -> int:
        """The unit that has the turn, or is about to hear that it has: the lower one has the even turns."""
        return self.ends[self.turn % 2]


@dataclass(frozen=True)
class TreeSnapshot:
    """The tree at one instant.

    Attributes:
        links: edges by their ends.
        members: units that belong to the tree.
        unjoined: living units that do not.
        dead: units in an outage.
        asks: the unit that each unjoined one asks to be admitted by, if any.
        heirs: the unit that would take over, by unit.
        missing_ids: robots that their units have not seen for long.
        ready: whether a unit knows the tree to be complete, so that robots may move.
    """

    links: Mapping[Ends, Link]
    members: frozenset[int]
    unjoined: frozenset[int]
    dead: frozenset[int]
    asks: Mapping[int, int]
    heirs: Mapping[int, int]
    missing_ids: frozenset[int]
    ready: bool


def tree_snapshot(words: Mapping[int, TreeStatus], dead: Iterable[int] = ()) -> TreeSnapshot:
    """The tree from the last word of each living unit."""
    members = frozenset(unit for unit, word in words.items() if word.tree_id != NO_ID)
    return TreeSnapshot(
        links=_links(words),
        members=members,
        unjoined=frozenset(words) - members,
        dead=frozenset(dead),
        asks={unit: word.asks_id for unit, word in words.items() if word.asks_id != NO_ID},
        heirs={unit: word.heir_id for unit, word in words.items() if word.heir_id != NO_ID},
        missing_ids=frozenset(robot for word in words.values() for robot in word.missing_ids.tolist()),
        ready=any(word.ready for word in words.values()),
    )


def _links(words: Mapping[int, TreeStatus]) -> dict[Ends, Link]:
    links: dict[Ends, Link] = {}
    for unit, word in sorted(words.items()):
        rows = zip(word.neighbor_ids.tolist(), word.turns.tolist(), word.pairs.tolist(), strict=True)
        for neighbor, turn, pair in rows:
            ends = min(unit, neighbor), max(unit, neighbor)
            told = Link(ends, turn, tuple(sorted(robot for robot in pair if robot != NO_ID)), False)
            other = links.get(ends)
            newer = told if other is None or told.turn > other.turn else other
            links[ends] = Link(ends, newer.turn, newer.pair, other is not None)
    return links


@dataclass
class TreeHistory:
    """Keeps the last word of each unit from step to step."""

    _words: dict[int, TreeStatus] = field(default_factory=dict, init=False)

    def see(self, step: Step, dead: Iterable[int]) -> TreeSnapshot | None:
        """The tree after a step; None where sets come from the safety radius alone."""
        for unit, frame in step.frames.items():
            if (word := frame.decision.report.tree) is not None:
                self._words[unit] = word
        for unit in dead:
            self._words.pop(unit, None)
        return tree_snapshot(self._words, dead) if self._words else None
