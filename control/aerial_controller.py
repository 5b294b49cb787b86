"""One aerial unit's controller: detections and reports in; goals, a report and a flight command out.

Units and robots may fall silent, and markers may be missed, so that everything a decision rests on has an age
at which it stops counting:

- A report that is older than `report_lifetime_s`, which is several images, is left out of the decision. The
  tree protocol remembers reports by itself, and has a limit of its own for them (`TreeRule.silence_s`).
- A robot that is not detected gets no goal in that image. Where control sets follow from a safety radius, it
  counts for a dwell time as where it was last seen (`skyherd.control.selection.safety_radius`).
- A robot follows a goal until the scenario's `robots.timeout_s` has passed since it received it
  (`skyherd.control.robots.goal_fusion`). Without any goal left it holds still.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.control.avoidance.image_border import HiddenRobots
from skyherd.control.avoidance.proximity import BodyRule, proximity
from skyherd.control.formation.registration import register_views
from skyherd.control.formation.roles import RoleRule, Roles
from skyherd.control.formation.schedule import Schedule
from skyherd.control.formation.size import SideConsensus, SizeRule
from skyherd.control.formation.template import Template
from skyherd.control.goals import cost_share, motion_goals
from skyherd.control.policy import FlightLaw, FlightTask, Selection, SelectionPolicy
from skyherd.control.rectification.ground_map import GroundMap
from skyherd.control.rectification.rectifier import Rectifier
from skyherd.control.team_clock import TeamClock
from skyherd.errors import DegenerateSetError
from skyherd.messages import Detections, FlightCommand, MotionGoals, Proximity, UnitReport, shared_ids
from skyherd.messages.checks import check_kind


@dataclass(frozen=True)
class Decision:
    """What a unit decides after one image.

    Attributes:
        detections: what it decided on: all markers of the image, rectified if the unit rectifies.
        goals: for its robots; None if it sees too few of them for a shape, or if they may not move yet.
        report: for the other units.
        flight: for its own autopilot.
        proximity: gaps between bodies, for its robots; None where robots are points.
        ground_map: the map through which the detections were taken; ideal (the identity) without a rectifier.
    """

    detections: Detections
    goals: MotionGoals | None
    report: UnitReport
    flight: FlightCommand
    proximity: Proximity | None = None
    ground_map: GroundMap = field(default_factory=GroundMap)


class AerialController:
    """Steers the robots of one unit from its detections and the other units' reports.

    What it keeps from image to image is in its parts, of which it has its own instances (rectifier, selection
    policy, flight law, roles, agreed marker side), but for its own last report, which the policy reads.

    Args:
        schedule: the whole shape, by robot, or several shapes one after the other.
        selection: which robots it controls; an instance of this unit's own.
        flight: how it flies; an instance of this unit's own.
        rectifier: learns from the markers what the camera does to the ground, and takes it off the
            detections; None takes detections as they are, which is right for square pixels, no lens
            distortion and no tilt only.
        nearest: neighbours whose distances it sends to each robot, besides the robots shared with other
            units.
        report_lifetime_s: a report older than this counts no more, since its sender may be gone.
        roles: how robots exchange their places in the shape; None for places that are fixed.
        size: bounds on the shape's size; None for a size that is free, as in the paper.
        bodies: how large robots and obstacles are; None for points.
        clock: how it learns the team's time from the stamps that it hears; None where its own clock shows it.
    """

    def __init__(
        self,
        schedule: Template | Schedule,
        selection: SelectionPolicy,
        flight: FlightLaw,
        *,
        rectifier: Rectifier | None = None,
        nearest: int = 3,
        report_lifetime_s: float = 2.0,
        roles: RoleRule | None = None,
        size: SizeRule | None = None,
        bodies: BodyRule | None = None,
        clock: TeamClock | None = None,
    ) -> None:
        check_kind("AerialController: schedule", schedule, (Template, Schedule), "a Template or a Schedule")
        self.schedule = Schedule(schedule) if isinstance(schedule, Template) else schedule
        self.template, self.selection, self.flight = self.schedule.first, selection, flight
        self.rectifier, self.nearest, self.report_lifetime_s = rectifier, nearest, report_lifetime_s
        self.roles = Roles(roles, self.template)
        self.bodies, self.hidden_robots = bodies, HiddenRobots(self.template.ids)
        self.size, self.side_consensus = size or SizeRule(), SideConsensus()
        self.clock = clock
        self._last_report: UnitReport | None = None

    def step(self, detections: Detections, reports: Sequence[UnitReport] = ()) -> Decision:
        """Decide on one image.

        Args:
            detections: all markers found in it, of robots, obstacles and others, at the time that the unit's
                own clock shows. An id that occurs twice counts as not seen: nobody can tell which of the two
                is the robot.
            reports: the last report received from each other unit, however old.
        """
        detections = self._in_team_time(detections.unambiguous(), reports)
        if self.rectifier is not None:
            detections = self.rectifier.rectify(detections)
        seen = detections.select(self.template.members)
        reports = [r for r in reports if r.time_s >= detections.time_s - self.report_lifetime_s]
        self._choose_roles(seen, reports)
        side_px = 0.0 if self.size.is_free else self.side_consensus.update(seen, reports)
        selection = self.selection.choose(seen, reports, self.roles.shape, self._last_report)
        goals = self._goals(seen, selection, reports, side_px) if selection.may_move else None
        self._last_report = UnitReport(
            unit_id=seen.unit_id,
            time_s=seen.time_s,
            image_size_px=seen.image_size_px,
            ids=seen.ids,
            points_px=seen.centers_px,
            controlled_ids=selection.controlled_ids,
            secure_ids=selection.secure_ids,
            tree=selection.tree_status,
            cost_sides2=cost_share(goals),
            side_px=side_px,
            roles=self.roles.reported,
        )
        ground_map = GroundMap() if self.rectifier is None else self.rectifier.ground_map
        return Decision(
            detections=detections,
            goals=goals,
            report=self._last_report,
            flight=self._fly(seen, selection, reports),
            proximity=self._near_bodies(detections, reports, ground_map),
            ground_map=ground_map,
        )

    def _in_team_time(self, detections: Detections, reports: Sequence[UnitReport]) -> Detections:
        """The detections with the team's time in place of the unit's own."""
        if self.clock is None:
            return detections
        own_s = np.array([detections.time_s])
        for report in reports:
            self.clock.hear(report.time_s, own_s)
        return replace(detections, time_s=float(self.clock.time_s(own_s)[0]))

    def _choose_roles(self, seen: Detections, reports: Sequence[UnitReport]) -> None:
        """Take up the shape of this time and the newest roles; exchange roles in the unit's own slot."""
        self.roles.use_template(self.schedule.at(seen.time_s))
        self.roles.receive(reports)
        if self.roles.may_exchange(seen.unit_id, seen.time_s, reports):
            self.roles.exchange(seen.unit_id, register_views(self.template.ids, seen, reports))

    def _fly(self, seen: Detections, selection: Selection, reports: Sequence[UnitReport]) -> FlightCommand:
        """Keep the control set in view; while robots may not move yet, hold the place or widen the view."""
        if selection.may_move:
            task = FlightTask(selection.controlled_ids, selection.sought_ids)
        elif selection.searches:
            task = FlightTask(selection.controlled_ids, seen.ids, widen=True)
        else:
            return FlightCommand.hold(seen.unit_id)
        return self.flight.command(seen, task, reports)

    def _near_bodies(
        self, detections: Detections, reports: Sequence[UnitReport], ground_map: GroundMap
    ) -> Proximity | None:
        """What robots have to keep away from, the border of the image included while a robot is hidden."""
        if self.bodies is None:
            return None
        hidden = self.hidden_robots.beyond(detections, reports, ground_map)
        return proximity(detections, self.template.ids, self.bodies, hidden)

    def _goals(
        self, seen: Detections, selection: Selection, reports: Sequence[UnitReport], side_px: float
    ) -> MotionGoals | None:
        try:
            return motion_goals(
                seen,
                selection.controlled_ids,
                self.roles.shape,
                shared_ids=shared_ids(selection.controlled_ids, reports),
                nearest=self.nearest,
                scales=self.size.scales(self.roles.shape, side_px),
            )
        except DegenerateSetError:
            return None
