"""Overlapping sets first, a tree after a failure: membership in Q, then in P (paper, Section VI)."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.control.policy import Selection, SelectionPolicy
from skyherd.control.selection.safety_radius import SafetyRadius
from skyherd.control.topology.conditions import check_conditions, control_matrix
from skyherd.control.tree.node_state import TreeSettings
from skyherd.control.tree.protocol import TreeProtocol
from skyherd.messages import Detections, UnitReport
from skyherd.messages.checks import check_numbers


@dataclass
class HybridSelection(SelectionPolicy):
    """Selection by the safety radius, and by the tree protocol once that has failed.

    With TC1 and TC2 alone every unit controls all robots inside its safety radius. More robots are shared and
    the team converges faster, but nothing maintains TC1 and TC2. Robots drift out of all sets, and neighbours
    then share fewer than two. The Lyapunov function V then stalls above zero, or each unit reaches a shape of
    its own and V falls to zero. Units report their sets and their Lyapunov terms V^j (eq. 9). The first unit
    that detects a failure starts the tree protocol, and its report makes the others follow.

    Attributes:
        overlapping: policy while V falls.
        tree_settings: settings of the protocol after V stalled.
        stall_s: V has stalled if it fell by less than `progress` over this time. TC1 and TC2 have failed if
            they did not hold for as long. Chosen: ten dwell times.
        progress: share of V.
        floor_sides: V is above zero while the RMS distance of robots to their goals is above this, marker
            sides.
        tree: the protocol, once started.
    """

    overlapping: SafetyRadius = field(default_factory=SafetyRadius)
    tree_settings: TreeSettings = field(default_factory=TreeSettings)
    stall_s: float = 20.0
    progress: float = 0.05
    floor_sides: float = 0.1
    tree: TreeProtocol | None = field(default=None, init=False)
    _lyapunov_values: deque[tuple[float, float]] = field(default_factory=deque, init=False)
    _in_q_s: float | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        check_numbers(self, positive=("stall_s",), not_negative=("progress", "floor_sides"))

    def choose(
        self, seen: Detections, reports: Sequence[UnitReport], shape: Template, last: UnitReport | None
    ) -> Selection:
        """Return the selection of the policy that is active now."""
        if self.tree is None and self._has_failed(last, reports, shape):
            self.tree = TreeProtocol(self.tree_settings)
        policy = self.overlapping if self.tree is None else self.tree
        return policy.choose(seen, reports, shape, last)

    def _has_failed(self, last: UnitReport | None, reports: Sequence[UnitReport], shape: Template) -> bool:
        """Return whether another unit started the tree, V has stalled, or TC1 and TC2 failed for too long."""
        if any(report.tree is not None for report in reports):
            return True
        if last is None:
            return False
        is_stalled = self._is_stalled(last, reports, shape)
        return self._is_out_of_q(last, reports, shape) or is_stalled

    def _is_stalled(self, last: UnitReport, reports: Sequence[UnitReport], shape: Template) -> bool:
        total = last.cost_sides2 + sum(report.cost_sides2 for report in reports)
        self._lyapunov_values.append((last.time_s, total))
        before = np.inf
        while last.time_s - self._lyapunov_values[0][0] > self.stall_s:
            before = self._lyapunov_values.popleft()[1]
        is_far = np.sqrt(2 * total / shape.ids.size) > self.floor_sides
        return bool(is_far and total > (1 - self.progress) * before)

    def _is_out_of_q(self, last: UnitReport, reports: Sequence[UnitReport], shape: Template) -> bool:
        sets = {report.unit_id: report.controlled_ids for report in (last, *reports)}
        if self._in_q_s is None or check_conditions(control_matrix(sets, shape.ids)).in_q:
            self._in_q_s = last.time_s
        return last.time_s - self._in_q_s > self.stall_s
