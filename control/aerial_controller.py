"""One aerial unit's mind: detections and reports in; goals, a report and a flight command out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control.avoidance.proximity import BodyRule, proximity
from skyherd.control.flight.laws import Duty, Flight
from skyherd.control.formation.registration import register_views
from skyherd.control.formation.roles import RoleRule, Roles
from skyherd.control.formation.schedule import Schedule
from skyherd.control.formation.size import SideConsensus, SizeRule
from skyherd.control.formation.template import Template
from skyherd.control.goals import motion_goals
from skyherd.control.hybrid_selection import HybridRule, HybridSelection, cost_share
from skyherd.control.topology.safety_radius import ControlSet, SafetyRadius
from skyherd.control.tree.node_state import TreeRule
from skyherd.control.tree.protocol import TreeProtocol
from skyherd.errors import DegenerateSetError
from skyherd.geometry import IntArray
from skyherd.messages import Detections, FlightCommand, MotionGoals, Proximity, UnitReport, shared_ids

Selection = SafetyRadius | TreeRule | HybridRule


@dataclass(frozen=True)
class Decision:
    """What a unit does after one image.

    `goals` is None if it sees too few of its robots for a shape, `encounters` where robots are points.
    """

    goals: MotionGoals | None
    report: UnitReport
    flight: FlightCommand
    proximity: Proximity | None = None


class AerialController:
    """Steers the robots of one unit from its detections alone.

    Args:
        program: the whole shape, by robot, or several one after the other.
        selection: which robots it controls, by the safety radius alone or by agreement with its neighbours.
        flight: how it flies.
        nearest: neighbours whose distances it tells each robot.
        report_lifetime_s: a report older than this counts no more: its sender may be gone.
        roles: how robots exchange their places; None for places that are fixed.
        size: bounds on the shape's size.
        bodies: how large robots and obstacles are; None for points.
    """

    def __init__(
        self,
        program: Template | Schedule,
        selection: Selection,
        flight: Flight,
        *,
        nearest: int = 3,
        report_lifetime_s: float = 2.0,
        roles: RoleRule | None = None,
        size: SizeRule | None = None,
        bodies: BodyRule | None = None,
    ) -> None:
        self.program = Schedule(program) if isinstance(program, Template) else program
        self.template, self.flight, self.nearest = self.program.first, flight, nearest
        self.report_lifetime_s = report_lifetime_s
        self.control_set = _begin(selection, self.template)
        self.roles, self.bodies = Roles(roles, self.template), bodies
        self.size, self.side_consensus = size or SizeRule(), SideConsensus()

    def step(self, detections: Detections, reports: Sequence[UnitReport] = ()) -> Decision:
        """Decide on one image, given the last report heard from each other unit."""
        seen = detections.select(self.template.members)
        reports = [r for r in reports if r.time_s >= detections.time_s - self.report_lifetime_s]
        self._choose_roles(seen, reports)
        side_px = 0.0 if self.size.is_free else self.side_consensus.update(seen, reports)
        controlled = self.control_set.update(seen, reports)
        goals = self._goals(seen, controlled, reports, side_px) if self.control_set.ready else None
        report = UnitReport(
            unit_id=seen.unit_id,
            time_s=seen.time_s,
            image_size_px=seen.image_size_px,
            ids=seen.ids,
            points_px=seen.centers_px,
            controlled_ids=controlled,
            secure_ids=self.control_set.secure(seen),
            tree=self.control_set.word(seen.time_s),
            cost_sides2=cost_share(goals),
            side_px=side_px,
            roles=self.roles.reported,
        )
        self.control_set.note(seen.time_s, report, reports)
        near = proximity(detections, self.template.ids, self.bodies) if self.bodies else None
        return Decision(goals, report, self._fly(seen, controlled, reports), near)

    def _choose_roles(self, seen: Detections, reports: Sequence[UnitReport]) -> None:
        self.roles.use_template(self.program.at(seen.time_s))
        self.roles.receive(reports)
        if self.roles.may_exchange(seen.unit_id, seen.time_s, reports):
            self.roles.exchange(seen.unit_id, register_views(self.template.ids, seen, reports))
        self.control_set.reshape(self.roles.shape)

    def _fly(self, seen: Detections, controlled: IntArray, reports: Sequence[UnitReport]) -> FlightCommand:
        """Serve the set and what is sought; while robots wait for the tree hold the place, or search."""
        if self.control_set.ready:
            return self.flight.command(seen, Duty(controlled, self.control_set.sought), reports)
        if self.control_set.searches:
            return self.flight.search(seen, controlled, reports)
        return FlightCommand(seen.unit_id, np.zeros(2), 0.0, 0.0)

    def _goals(
        self, seen: Detections, controlled: IntArray, reports: Sequence[UnitReport], side_px: float
    ) -> MotionGoals | None:
        try:
            return motion_goals(
                seen,
                controlled,
                self.roles.shape,
                shared_ids=shared_ids(controlled, reports),
                nearest=self.nearest,
                scales=self.size.scales(self.roles.shape, side_px),
            )
        except DegenerateSetError:
            return None


def _begin(selection: Selection, template: Template) -> ControlSet | TreeProtocol | HybridSelection:
    """The set of a unit that has seen and heard nothing yet."""
    if isinstance(selection, TreeRule):
        return TreeProtocol(selection, template)
    if isinstance(selection, HybridRule):
        return HybridSelection(selection, template)
    return ControlSet(selection)
