"""Controller of one aerial unit: detections and reports in; goals, a report and a flight command out.

Units and robots may fail, and markers may be missed. Every input of a decision therefore becomes stale at a
defined age:

- A report older than `report_lifetime_s`, several image periods, is ignored. The tree protocol stores reports
  itself, with its own timeout (`TreeSettings.silence_s`).
- A robot that is not detected gets no goal in that image. With a safety radius, its last position counts for
  one dwell time (`skyherd.control.selection.safety_radius`).
- A robot follows a goal for `robots.timeout_s` after reception (`skyherd.control.robots.goal_fusion`). This
  timeout is a watchdog: without a fresh goal the robot stops.
"""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.control.avoidance.image_border import HiddenRobots
from skyherd.control.avoidance.proximity import BodyRule, proximity
from skyherd.control.camera_check import CameraCheck, CameraRule
from skyherd.control.formation.motion import LeadRule, drift_mps, leads_px
from skyherd.control.formation.registration import register_views
from skyherd.control.formation.roles import RoleRule, Roles
from skyherd.control.formation.schedule import Schedule
from skyherd.control.formation.size import SideConsensus, SizeRule
from skyherd.control.formation.template import Template
from skyherd.control.goals import led_goals, lyapunov_term, motion_goals
from skyherd.control.identities import AmbiguousIds, Turns
from skyherd.control.policy import FlightLaw, FlightTask, Selection, SelectionPolicy
from skyherd.control.rectification.ground_map import GroundMap
from skyherd.control.rectification.rectifier import Rectifier, rectified
from skyherd.control.team_clock import TeamClock
from skyherd.errors import DegenerateSetError, InputError
from skyherd.geometry import Array
from skyherd.messages import Detections, FlightCommand, MotionGoals, Proximity, UnitReport, shared_ids
from skyherd.messages.checks import check_kind
from skyherd.messages.short_repr import short_repr


@dataclass(frozen=True)
class Decision:
    """Decision of a unit after one image.

    Attributes:
        detections: detections of the decision: all markers of the image without ambiguous ids, rectified if
            the unit rectifies.
        goals: goals for its robots; None if too few robots are visible for a shape, or if robots may not move
            yet.
        report: report to the other units.
        flight: command to its own autopilot.
        proximity: gaps between bodies, for its robots; None if robots are points.
        ground_map: rectification map of the detections; the identity without a rectifier.
        turns: goals that make robots with ambiguous ids turn, so that they are told apart; None without any.
        suspicion: reason why the unit suspects its camera and sends nothing; empty if it trusts the camera.
            The report then only lists the markers of the image, and is not sent.
    """

    detections: Detections
    goals: MotionGoals | None
    report: UnitReport
    flight: FlightCommand
    proximity: Proximity | None = None
    ground_map: GroundMap = field(default_factory=GroundMap)
    turns: MotionGoals | None = None
    suspicion: str = ""

    __repr__ = short_repr


class AerialController:
    """Controller that steers the robots of one unit from its detections and the other units' reports.

    State between images is kept in the parts: rectifier, selection policy, flight law, roles, ambiguous ids
    and agreed marker side. Each unit has its own instances. The controller itself keeps only its last report,
    which the policy reads.

    Args:
        schedule: the whole shape, by robot, or a sequence of shapes.
        selection: policy that selects the controlled robots; one instance per unit.
        flight: flight law; one instance per unit.
        rectifier: estimates the map from the image to the ground from the markers, and applies it to the
            detections. None uses raw detections, which is correct only for square pixels without lens
            distortion and tilt.
        nearest: number of nearest neighbours whose distances are sent to each robot, besides robots shared
            with other units.
        report_lifetime_s: age at which a report is stale, since its sender may have failed.
        roles: settings of the role exchange; None for fixed roles.
        size: bounds on the size of the shape; None for a free size, as in the paper.
        bodies: sizes of robots and obstacles; None for points.
        clock: estimates the team's time from received time stamps; None if the unit's own clock shows it.
        camera: the robots' response to goals, by which the unit detects a frozen or replayed camera; None to
            trust every image.
        lead: the robots' response to goals, by which the unit leads them along with a moving shape; None if
            the shape may not move.
        asks_turns: whether the unit makes robots with ambiguous ids turn, so that `Copies` tells them apart.

    Raises:
        InputError: the shape moves, and `lead` is None.
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
        camera: CameraRule | None = None,
        lead: LeadRule | None = None,
        asks_turns: bool = False,
    ) -> None:
        check_kind("AerialController: schedule", schedule, (Template, Schedule), "a Template or a Schedule")
        self.schedule = Schedule(schedule) if isinstance(schedule, Template) else schedule
        self.template, self.selection, self.flight = self.schedule.first, selection, flight
        self.rectifier, self.nearest, self.report_lifetime_s = rectifier, nearest, report_lifetime_s
        self.roles = Roles(roles, self.template)
        self.bodies, self.hidden_robots = bodies, HiddenRobots(self.template.ids)
        self.ambiguous_ids, self.turns = AmbiguousIds(), Turns() if asks_turns else None
        self.size, self.side_consensus = size or SizeRule(), SideConsensus()
        self.clock = clock
        if self.schedule.motions and lead is None:
            raise InputError("AerialController: lead", "none for a moving shape", "a LeadRule")
        self.lead = lead
        self.camera_check = None if camera is None else CameraCheck(camera, self.template.ids)
        self._last_report: UnitReport | None = None

    def step(
        self,
        detections: Detections,
        reports: Sequence[UnitReport] = (),
        *,
        obeying_ids: AbstractSet[int] | None = None,
    ) -> Decision:
        """Decide on one image.

        Args:
            detections: all markers of the image, with the time of the unit's own clock. Markers with a
                repeated id are ambiguous: they get no goals, and are bodies without identity.
            reports: the last report received from each other unit, of any age.
            obeying_ids: robots that follow goals now, by which the unit checks its camera; all if None.

        Raises:
            InputError: `detections` is not a Detections, as an image.
        """
        check_kind("AerialController.step: detections", detections, Detections, "what a detector returns")
        ambiguous = self.ambiguous_ids.update(detections)
        everything = self._in_team_time(detections, reports)
        detections = everything.without(ambiguous)
        recent = [r for r in reports if r.time_s >= detections.time_s - self.report_lifetime_s]
        if self.camera_check is not None and (suspicion := self.camera_check.look(everything, recent)):
            return self._suspect(detections.select(self.template.members), suspicion)
        if self.rectifier is not None:
            detections = self.rectifier.rectify(detections)
        seen = detections.select(self.template.members)
        self._choose_roles(seen, recent)
        side_px = 0.0 if self.size.is_free else self.side_consensus.update(seen, recent)
        selection = self.selection.choose(seen, recent, self.roles.shape, self._last_report)
        goals = self._goals(seen, selection, recent, side_px) if selection.may_move else None
        cost_sides2 = lyapunov_term(goals)
        goals = self._led(goals, seen, recent, side_px)
        self._last_report = UnitReport(
            unit_id=seen.unit_id,
            time_s=seen.time_s,
            image_size_px=seen.image_size_px,
            ids=seen.ids,
            points_px=seen.centers_px,
            controlled_ids=selection.controlled_ids,
            secure_ids=selection.secure_ids,
            tree=selection.tree_status,
            cost_sides2=cost_sides2,
            side_px=side_px,
            roles=self.roles.reported,
        )
        ground_map = GroundMap() if self.rectifier is None else self.rectifier.ground_map
        bodies = rectified(everything, ground_map) if ambiguous else detections
        near = self._near_bodies(bodies, ambiguous, recent, ground_map)
        if self.camera_check is not None:
            self.camera_check.command(goals, near, recent, obeying_ids)
        return Decision(
            detections=detections,
            goals=goals,
            report=self._last_report,
            flight=self._fly(seen, selection, recent),
            proximity=near,
            ground_map=ground_map,
            turns=self._turns(everything, ambiguous),
        )

    def _suspect(self, seen: Detections, suspicion: str) -> Decision:
        """Return the decision while the camera is suspected: hold the position, and send nothing."""
        hold = FlightCommand.hold(seen.unit_id)
        return Decision(seen, None, UnitReport.of_image(seen), hold, suspicion=suspicion)

    def _in_team_time(self, detections: Detections, reports: Sequence[UnitReport]) -> Detections:
        """Return the detections with the team's time instead of the unit's own time."""
        if self.clock is None:
            return detections
        own_s = np.array([detections.time_s])
        for report in reports:
            self.clock.hear(report.time_s, own_s)
        return replace(detections, time_s=float(self.clock.time_s(own_s)[0]))

    def _choose_roles(self, seen: Detections, reports: Sequence[UnitReport]) -> None:
        """Update the shape and the roles, and exchange roles in the unit's own slot."""
        self.roles.use_template(self.schedule.at(seen.time_s))
        self.roles.receive(reports)
        if self.roles.may_exchange(seen.unit_id, seen.time_s, reports):
            self.roles.exchange(seen.unit_id, register_views(self.template.ids, seen, reports))

    def _fly(self, seen: Detections, selection: Selection, reports: Sequence[UnitReport]) -> FlightCommand:
        """Keep the control set in view; before robots may move, hold the position or widen the view."""
        if selection.may_move:
            task = FlightTask(selection.controlled_ids, selection.sought_ids, drift_mps=self._drift_mps(seen))
        elif selection.searches:
            task = FlightTask(selection.controlled_ids, seen.ids, widen=True)
        else:
            return FlightCommand.hold(seen.unit_id)
        return self.flight.command(seen, task, reports)

    def _turns(self, everything: Detections, ambiguous: AbstractSet[int]) -> MotionGoals | None:
        """Return the goals that make robots with ambiguous ids turn, if the unit asks for turns."""
        return None if self.turns is None else self.turns.ask(everything, ambiguous & self.template.members)

    def _near_bodies(
        self,
        detections: Detections,
        ambiguous: frozenset[int],
        reports: Sequence[UnitReport],
        ground_map: GroundMap,
    ) -> Proximity | None:
        """Return the bodies that robots must avoid, with the image border while a robot is hidden."""
        if self.bodies is None:
            return None
        hidden = self.hidden_robots.beyond(detections, reports, ground_map)
        return proximity(detections, self.template.ids, self.bodies, hidden, ambiguous=ambiguous)

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

    def _led(
        self, goals: MotionGoals | None, seen: Detections, reports: Sequence[UnitReport], side_px: float
    ) -> MotionGoals | None:
        """Return the goals, led along with the motion of the shape."""
        motion = self.schedule.motion_at(seen.time_s)
        if goals is None or self.lead is None or motion.is_rest:
            return goals
        leads = leads_px(
            motion,
            self.lead,
            template=self.roles.shape,
            seen=seen,
            ids=goals.ids,
            reports=reports,
            scales=self.size.scales(self.roles.shape, side_px),
        )
        return led_goals(goals, seen, leads)

    def _drift_mps(self, seen: Detections) -> Array:
        """Return the velocity (2,) of the moving shape at the image centre, m/s."""
        motion = self.schedule.motion_at(seen.time_s)
        if self.lead is None or motion.is_rest:
            return np.zeros(2)
        center_px = complex(*((seen.image_size_px - 1) / 2))
        return drift_mps(motion, self.lead, template=self.roles.shape, seen=seen, center_px=center_px)
