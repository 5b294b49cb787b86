"""The newest report received from each other unit.

Reports are read by many rules in every image, so that work on them is done once and then kept. A report turns
its arrays into a set of robots and a table of distances when somebody first asks for them (`UnitReport`), and
what follows from all reports together, such as the robots that anybody claims, is computed once an image
(`skyherd.control.tree.node_state.Situation`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from skyherd.control.tree.edge import Robots
from skyherd.messages import NO_ID, TreeStatus, UnitReport


@dataclass(frozen=True, slots=True)
class PeerReport:
    """A report of one unit that takes part in the protocol.

    Attributes:
        report: as received.
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
        """When the sender's image was taken."""
        return self.report.time_s

    @property
    def is_member(self) -> bool:
        """Whether the sender belongs to a tree."""
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
        """Robots that the sender sees inside a radius, in half images."""
        return frozenset(robot for robot, distance in self.distances.items() if distance < radius)


@dataclass
class PeerReports:
    """The newest report of each unit; older ones that arrive later, and repeated ones, are dropped.

    Attributes:
        newest: the last report of each unit.
        last_as_member: the last report that each unit sent as a member of a tree. It names the unit's robots,
            edges and heir, and is what the others go by when the unit falls silent.
    """

    newest: dict[int, PeerReport] = field(default_factory=dict, init=False)
    last_as_member: dict[int, PeerReport] = field(default_factory=dict, init=False)

    def take(self, reports: Sequence[UnitReport]) -> tuple[PeerReport, ...]:
        """Remember reports; returns those that are newer than what was known of their senders."""
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
