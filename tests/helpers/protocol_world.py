"""A small world for the tree protocol: units that see given robots, and a controllable radio.

The caller controls time, the images of units, the visible robots, and the fate of each message. `holders`,
`in_p` and `edge_faults` describe the current state. The world does not depend on the units' decisions.
"""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from skyherd.control import Template
from skyherd.control.topology.conditions import check_conditions, control_matrix
from skyherd.control.tree.node_state import TreeSettings
from skyherd.control.tree.protocol import TreeProtocol
from skyherd.messages import Detections, UnitReport

SIZE_PX = np.array([800, 800])
Letter = tuple[int, UnitReport]
"""Receiver and report of a message in transit."""


@dataclass
class ProtocolWorld:
    """Units, robots, clock and radio.

    Attributes:
        units: number of units.
        robots: number of robots.
        rule: settings of the protocol.
        views: visible robots of each unit, with their distances from its image centre, half images.
        make: factory of a unit's protocol.
        nodes: protocols of the living units.
        waiting: letters in transit; a copy of a delivered one may stay, and arrive again.
        inbox: last report to arrive at each unit from each other one, new or old.
    """

    units: int
    robots: int
    rule: TreeSettings
    views: list[dict[int, float]]
    make: Callable[[TreeSettings], TreeProtocol] = TreeProtocol
    time_s: float = 0.0
    nodes: dict[int, TreeProtocol] = field(default_factory=dict)
    waiting: list[Letter] = field(default_factory=list)
    inbox: list[dict[int, UnitReport]] = field(default_factory=list)
    sets: dict[int, set[int]] = field(default_factory=dict)
    imaged_s: dict[int, float] = field(default_factory=dict)
    latest: dict[int, UnitReport] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.robots)
        points = rng.normal(size=self.robots) + 1j * rng.normal(size=self.robots)
        self.template = Template(np.arange(self.robots), 100 * points)
        self.inbox = [{} for _ in range(self.units)]
        for unit in range(self.units):
            self.revive(unit)

    def revive(self, unit: int) -> None:
        """Restart a unit without memory."""
        self.nodes[unit] = self.make(self.rule)
        self.sets[unit], self.imaged_s[unit] = set(), self.time_s

    def crash(self, unit: int) -> None:
        """Silence a unit; its messages in transit still arrive."""
        del self.nodes[unit], self.imaged_s[unit]
        self.sets[unit] = set()
        self.inbox[unit].clear()
        self.waiting = [letter for letter in self.waiting if letter[0] != unit]

    def image(self, unit: int) -> None:
        """Let a unit take an image, decide, and report to all others."""
        seen = self._detections(unit)
        reports = list(self.inbox[unit].values())
        selection = self.nodes[unit].choose(seen, reports, self.template, self.latest.get(unit))
        controlled = selection.controlled_ids
        report = UnitReport(
            unit_id=unit,
            time_s=seen.time_s,
            image_size_px=seen.image_size_px,
            ids=seen.ids,
            points_px=seen.centers_px,
            controlled_ids=controlled,
            secure_ids=selection.secure_ids,
            tree=selection.tree_status,
        )
        self.sets[unit], self.imaged_s[unit] = set(controlled.tolist()), self.time_s
        self.latest[unit] = report
        self.waiting += [(other, report) for other in self.nodes if other != unit]

    def deliver(self, index: int, *, keep: bool = False) -> None:
        """Deliver a letter, possibly late; a kept letter arrives again."""
        receiver, report = self.waiting[index]
        if not keep:
            del self.waiting[index]
        if receiver in self.nodes:
            self.inbox[receiver][report.unit_id] = report

    def deliver_all(self) -> None:
        """Deliver all letters in the order of sending."""
        while self.waiting:
            self.deliver(0)

    def deliver_to(self, unit: int) -> None:
        """Deliver all letters to one unit; letters to others wait."""
        for letter in [letter for letter in self.waiting if letter[0] == unit]:
            self.deliver(self.waiting.index(letter))

    def inbox_of(self, unit: int, other: int) -> list[UnitReport]:
        """Return the newest report of one unit that arrived at another, in a list; empty without one."""
        return [report for sender, report in self.inbox[unit].items() if sender == other]

    def quiet(self, seconds: float, step_s: float = 0.5) -> None:
        """Advance time without faults: every unit takes its images, and every letter arrives."""
        for _ in range(round(seconds / step_s)):
            self.time_s += step_s
            for unit in list(self.nodes):
                self.deliver_all()
                self.image(unit)

    def _detections(self, unit: int) -> Detections:
        ids = np.array(sorted(self.views[unit]), dtype=np.int64)
        radius = np.array([self.views[unit][robot] for robot in ids.tolist()])
        middle, turn = (SIZE_PX - 1) / 2, np.stack([np.cos(ids), np.sin(ids)], axis=1)
        centers = middle + SIZE_PX.min() / 2 * radius[:, None] * turn
        return Detections(
            unit_id=unit,
            time_s=self.time_s,
            image_size_px=SIZE_PX,
            ids=ids,
            centers_px=centers,
            headings_rad=np.zeros(ids.size),
            sides_px=np.full(ids.size, 20.0),
            corners_px=np.zeros((ids.size, 4, 2)),
            covariances=np.zeros((ids.size, 3, 3)),
        )

    # --- current state ---

    def holders(self) -> Counter[int]:
        """Return the number of units that control each robot."""
        return Counter(robot for members in self.sets.values() for robot in members)

    def in_p(self) -> bool:
        """Return whether TC1-TC5 hold for the living units."""
        sets = {unit: np.array(sorted(self.sets[unit]), dtype=np.int64) for unit in self.nodes}
        return check_conditions(control_matrix(sets, self.template.ids)).in_p

    def edge_faults(self, but: Iterable[int] = ()) -> list[str]:
        """Return edges whose ends differ by more than the current turn, and sets that share other robots."""
        faults = []
        for one in sorted(self.nodes):
            for two in sorted(self.nodes):
                if one < two:
                    faults += self._faults_between(one, two, set(but))
        return faults

    def _faults_between(self, one: int, two: int, but: set[int]) -> list[str]:
        here = self.nodes[one].state.edges.get(two)
        there = self.nodes[two].state.edges.get(one)
        common = self.sets[one] & self.sets[two]
        ends = [end for end in (here, there) if end is not None]
        agreed = max(ends, key=lambda end: end.turn).pair if ends else frozenset()
        faults = []
        if common - but != agreed - but:
            faults.append(f"units {one} and {two} share {sorted(common)}, their edge has {sorted(agreed)}")
        if here is not None and there is not None:
            if abs(here.turn - there.turn) > 1:
                faults.append(f"units {one} and {two} are at turns {here.turn} and {there.turn}")
            elif here.turn == there.turn and here.pair != there.pair:
                faults.append(f"units {one} and {two} have {here.pair} and {there.pair} at turn {here.turn}")
            if here.is_my_turn and there.is_my_turn:
                faults.append(f"units {one} and {two} both have the turn")
        return faults
