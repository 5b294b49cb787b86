"""Newest report received from each other unit.

Many rules read the reports in every image, so that derived values are computed once and cached. A report
computes its set of robots and its table of distances at the first access (`UnitReport`). Values that depend
on all reports, such as the claimed robots, are computed once per image
(`skyherd.control.tree.node_state.Situation`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from skyherd.control.tree.edge import Robots
from skyherd.messages import NO_ID, TreeStatus, UnitReport


@dataclass(frozen=True, slots=True)
class PeerReport:
    """Report of one unit that takes part in the protocol.

    Attributes:
        report: the received report.
        tree: its part about the tree.
    """

    report: UnitReport
    tree: TreeStatus

    @property
    def unit_id(self) -> int:
        """The sender."""
        return self.report.unit_id

    @property
    def time_s(self) -> float:
        """Time of the sender's image."""
        return self.report.time_s

    @property
    def is_member(self) -> bool:
        """True if the sender belongs to a tree."""
        return self.tree.tree_id != NO_ID

    @property
    def controlled(self) -> Robots:
        """Robots that the sender controls."""
        return self.report.controlled

    @property
    def distances(self) -> dict[int, float]:
        """Distances of the robots that the sender sees from its image centre, in half images."""
        return self.report.distances

    @property
    def paired(self) -> Robots:
        """Robots in the pairs of the sender's edges."""
        return self.tree.paired

    def near(self, radius: float) -> Robots:
        """Return the robots that the sender sees inside a radius, in half images."""
        return frozenset(robot for robot, distance in self.distances.items() if distance < radius)


@dataclass
class PeerReports:
    """Newest report of each unit; stale reports that arrive later, and repeated ones, are ignored.

    Attributes:
        newest: the last report of each unit.
        last_as_member: the last report of each unit as a member of a tree. It contains the unit's robots,
            edges and heir, and is the basis of failover when the unit falls silent.
    """

    newest: dict[int, PeerReport] = field(default_factory=dict, init=False)
    last_as_member: dict[int, PeerReport] = field(default_factory=dict, init=False)

    def take(self, reports: Sequence[UnitReport]) -> tuple[PeerReport, ...]:
        """Store reports; return those that are newer than the known ones of their senders."""
        news = []
        for report in reports:
            last = self.newest.get(report.unit_id)
            if report.tree is not None and (last is None or report.time_s > last.time_s):
                peer = PeerReport(report, report.tree)
                self.newest[report.unit_id] = peer
                if peer.is_member:
                    self.last_as_member[report.unit_id] = peer
                news.append(peer)
        return tuple(news)
