"""What a unit heard from the others: the newest report of each, and who is still alive."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from skyherd.control.edge import NO_ROBOTS, Robots
from skyherd.control.selection import centre_distances
from skyherd.messages import NOBODY, TreeWord, UnitReport


@dataclass(frozen=True)
class Heard:
    """One unit's newest report, read once.

    Attributes:
        report: as it came.
        tree: what it says of the tree.
        controlled: robots that the unit controls.
        distances: from its image centre, of the robots that it sees.
        paired: robots in the pairs of its edges.
    """

    report: UnitReport
    tree: TreeWord
    controlled: Robots
    distances: dict[int, float]
    paired: Robots

    @property
    def is_member(self) -> bool:
        """Whether the unit belongs to a tree."""
        return self.tree.tree_id != NOBODY

    def near(self, radius: float) -> Robots:
        """Robots that it sees inside a radius."""
        return frozenset(robot for robot, distance in self.distances.items() if distance < radius)


def read(report: UnitReport, tree: TreeWord) -> Heard:
    """Read a report into sets."""
    distances = dict(zip(report.ids.tolist(), centre_distances(report).tolist(), strict=True))
    paired = frozenset(tree.pairs.ravel().tolist()) - {NOBODY}
    return Heard(report, tree, frozenset(report.controlled_ids.tolist()), distances, paired)


@dataclass
class Hearsay:
    """The newest report of each unit; older ones that arrive later, and repeated ones, are dropped.

    Attributes:
        silence_s: a unit that was not heard for so long is dead.
        newest: what each unit said last.
        bequest: what each said last as a member of a tree: its robots, edges and heir.
    """

    silence_s: float
    newest: dict[int, Heard] = field(default_factory=dict, init=False)
    bequest: dict[int, Heard] = field(default_factory=dict, init=False)

    def take(self, reports: Sequence[UnitReport]) -> list[Heard]:
        """Take in reports; those that are news."""
        news = []
        for report in reports:
            last = self.newest.get(report.unit_id)
            if report.tree is not None and (last is None or report.time_s > last.report.time_s):
                heard = read(report, report.tree)
                self.newest[report.unit_id] = heard
                if heard.is_member:
                    self.bequest[report.unit_id] = heard
                news.append(heard)
        return news

    def alive(self, unit: int, time_s: float) -> bool:
        """Whether a unit was heard of late."""
        heard = self.newest.get(unit)
        return heard is not None and time_s - heard.report.time_s <= self.silence_s

    def fresh(self, time_s: float) -> list[Heard]:
        """What units that are alive said last, in the units' order."""
        return [heard for unit, heard in sorted(self.newest.items()) if self.alive(unit, time_s)]

    def members(self, time_s: float) -> list[Heard]:
        """Those of them that belong to a tree."""
        return [heard for heard in self.fresh(time_s) if heard.is_member]

    def seen_by(self, unit: int) -> Robots:
        """Robots that a unit reported to see."""
        heard = self.newest.get(unit)
        return NO_ROBOTS if heard is None else frozenset(heard.distances)
