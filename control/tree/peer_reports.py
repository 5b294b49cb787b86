"""What a unit heard from the others: the newest report of each, and who is still alive."""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from functools import cached_property

from skyherd.control.tree.edge import NO_ROBOTS, Robots
from skyherd.messages import NO_ID, TreeStatus, UnitReport


@dataclass(slots=True)
class PeerReport:
    """One unit's newest report, of one that says what it has to say of the tree."""

    report: UnitReport
    tree: TreeStatus

    @property
    def is_member(self) -> bool:
        """Whether the unit belongs to a tree."""
        return self.tree.tree_id != NO_ID

    @property
    def controlled(self) -> Robots:
        """Robots that the unit controls."""
        return self.report.controlled

    @property
    def distances(self) -> dict[int, float]:
        """Distances of the robots that it sees from its image centre, in half images."""
        return self.report.distances

    @property
    def paired(self) -> Robots:
        """Robots in the pairs of its edges."""
        return self.tree.paired

    def near(self, radius: float) -> Robots:
        """Robots that it sees inside a radius."""
        return frozenset(robot for robot, distance in self.distances.items() if distance < radius)


@dataclass
class Now:
    """What counts at one instant: units that are alive, those of them in a tree, robots that these claim."""

    time_s: float
    fresh: list[PeerReport]
    members: list[PeerReport]

    @cached_property
    def claimed(self) -> AbstractSet[int]:
        """Robots that members say they control."""
        return frozenset().union(*(heard.controlled for heard in self.members))


@dataclass
class PeerReports:
    """The newest report of each unit; older ones that arrive later, and repeated ones, are dropped.

    Attributes:
        silence_s: a unit that was not heard for so long is dead.
        newest: what each unit said last.
        bequest: what each said last as a member of a tree: its robots, edges and heir.
    """

    silence_s: float
    newest: dict[int, PeerReport] = field(default_factory=dict, init=False)
    bequest: dict[int, PeerReport] = field(default_factory=dict, init=False)
    _now: Now | None = field(default=None, init=False)

    def take(self, reports: Sequence[UnitReport]) -> list[PeerReport]:
        """Take in reports; those that are news."""
        news = []
        for report in reports:
            last = self.newest.get(report.unit_id)
            if report.tree is not None and (last is None or report.time_s > last.report.time_s):
                heard = PeerReport(report, report.tree)
                self.newest[report.unit_id] = heard
                if heard.is_member:
                    self.bequest[report.unit_id] = heard
                news.append(heard)
        self._now = None
        return news

    def alive(self, unit: int, time_s: float) -> bool:
        """Whether a unit was heard of late."""
        heard = self.newest.get(unit)
        return heard is not None and time_s - heard.report.time_s <= self.silence_s

    def fresh(self, time_s: float) -> list[PeerReport]:
        """What units that are alive said last, in the units' order."""
        return self._of_late(time_s).fresh

    def members(self, time_s: float) -> list[PeerReport]:
        """Those of them that belong to a tree."""
        return self._of_late(time_s).members

    def claimed(self, time_s: float) -> AbstractSet[int]:
        """Robots that members say they control."""
        return self._of_late(time_s).claimed

    def _of_late(self, time_s: float) -> Now:
        """What counts now, found once an instant."""
        if self._now is None or self._now.time_s != time_s:
            fresh = [
                heard
                for _, heard in sorted(self.newest.items())
                if time_s - heard.report.time_s <= self.silence_s
            ]
            self._now = Now(time_s, fresh, [heard for heard in fresh if heard.is_member])
        return self._now

    def seen_by(self, unit: int) -> AbstractSet[int]:
        """Robots that a unit reported to see."""
        heard = self.newest.get(unit)
        return NO_ROBOTS if heard is None else heard.distances.keys()
