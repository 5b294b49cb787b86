"""Free overlaps first, a tree when they fail: membership in Q with a way back to P.

With TC1 and TC2 alone every unit controls all robots inside its safety radius; more robots are shared and
the shape comes faster, but nothing keeps TC1 and TC2: robots drift out of all sets, and neighbours come to
share fewer than two. Then V stalls above zero, or falls to zero with every unit content with a shape of its
own. Units tell one another their sets and their shares of V; the first to notice either builds the tree,
and its report makes the others follow (the companion paper's way out of a wrong equilibrium, with TC1-TC5
by construction).
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.control.topology.conditions import check_conditions, control_matrix
from skyherd.control.topology.safety_radius import NO_ROBOTS, ControlSet, SafetyRadius
from skyherd.control.tree.node_state import TreeRule
from skyherd.control.tree.protocol import TreeProtocol
from skyherd.geometry import IntArray
from skyherd.messages import Detections, MotionGoals, TreeStatus, UnitReport


@dataclass(frozen=True)
class HybridRule:
    """Settings.

    Attributes:
        free: the rule while V falls.
        tree: the protocol after it stalled.
        stall_s: V has stalled if it fell by less than `progress` over this time; TC1 and TC2 have failed if
            they did not hold for as long.
        progress: as a share of V.
        floor_sides: V counts as above zero while robots are this far from their goals, RMS in marker sides.
    """

    free: SafetyRadius = field(default_factory=SafetyRadius)
    tree: TreeRule = field(default_factory=TreeRule)
    stall_s: float = 20.0
    progress: float = 0.05
    floor_sides: float = 0.1


def cost_share(goals: MotionGoals | None) -> float:
    """V_j = 1/2 Σ_i (rho_i / side_i)², marker sides squared (paper, eq. 9); 0 without goals."""
    return 0.0 if goals is None else float(((goals.rho_px / goals.sides_px) ** 2).sum() / 2)


@dataclass
class HybridSelection:
    """S_j^c of one unit: by the safety radius, and by the protocol once V has stalled."""

    rule: HybridRule
    template: Template
    free: ControlSet = field(init=False)
    tree: TreeProtocol | None = field(default=None, init=False)
    _costs: deque[tuple[float, float]] = field(default_factory=deque, init=False)
    _held_s: float | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.free = ControlSet(self.rule.free)

    @property
    def ready(self) -> bool:
        """Whether robots may move: at once, and again when the tree is complete."""
        return self.tree is None or self.tree.ready

    @property
    def searches(self) -> bool:
        """Whether the tree lacks units or robots that nobody finds."""
        return self.tree is not None and self.tree.searches

    @property
    def sought(self) -> IntArray:
        """Robots that would bind the tree firmly."""
        return NO_ROBOTS if self.tree is None else self.tree.sought

    def update(self, seen: Detections, reports: Sequence[UnitReport]) -> IntArray:
        """S_j^c after an image, ascending."""
        if self.tree is None and any(report.tree is not None for report in reports):
            self.tree = TreeProtocol(self.rule.tree, self.template)
        return (self.tree or self.free).update(seen, reports)

    def secure(self, seen: Detections) -> IntArray:
        """Robots of the set that are well held now."""
        return (self.tree or self.free).secure(seen)

    def reshape(self, template: Template) -> None:
        """Robots have exchanged places."""
        self.template = template
        if self.tree is not None:
            self.tree.reshape(template)

    def word(self, time_s: float) -> TreeStatus | None:
        """What the unit says of its standing in the tree, once there is one."""
        return None if self.tree is None else self.tree.word(time_s)

    def note(self, time_s: float, own: UnitReport, reports: Sequence[UnitReport]) -> None:
        """Take in the team's sets and costs after an image; begin the tree if free overlaps have failed."""
        if self.tree is None and (
            self._is_stalled(time_s, own, reports) or self._is_broken(time_s, own, reports)
        ):
            self.tree = TreeProtocol(self.rule.tree, self.template)

    def _is_stalled(self, time_s: float, own: UnitReport, reports: Sequence[UnitReport]) -> bool:
        total = own.cost_sides2 + sum(report.cost_sides2 for report in reports)
        self._costs.append((time_s, total))
        before = np.inf
        while time_s - self._costs[0][0] > self.rule.stall_s:
            before = self._costs.popleft()[1]
        is_far = np.sqrt(2 * total / self.template.ids.size) > self.rule.floor_sides
        return bool(is_far and total > (1 - self.rule.progress) * before)

    def _is_broken(self, time_s: float, own: UnitReport, reports: Sequence[UnitReport]) -> bool:
        sets = {report.unit_id: report.controlled_ids for report in (own, *reports)}
        holds = check_conditions(control_matrix(sets, self.template.ids)).in_q
        if holds or self._held_s is None:
            self._held_s = time_s
        return time_s - self._held_s > self.rule.stall_s
