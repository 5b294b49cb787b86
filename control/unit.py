"""One aerial unit's mind: detections and reports in; goals, a report and a flight command out."""

from collections.abc import Sequence
from dataclasses import dataclass

from skyherd.control.flight import Flight
from skyherd.control.goals import motion_goals
from skyherd.control.selection import ControlSet, SafetyRadius
from skyherd.control.template import Template
from skyherd.errors import DegenerateSetError
from skyherd.messages import Detections, FlightCommand, MotionGoals, UnitReport, shared_ids


@dataclass(frozen=True)
class Decision:
    """What a unit does after one image; `goals` is None if it sees too few of its robots for a shape."""

    goals: MotionGoals | None
    report: UnitReport
    flight: FlightCommand


class AerialController:
    """Steers the robots of one unit from its detections alone.

    Args:
        template: the whole shape, by robot.
        selection: which robots it controls.
        flight: how it flies.
        nearest: neighbours whose distances it tells each robot.
        report_lifetime_s: a report older than this counts no more: its sender may be gone.
    """

    def __init__(
        self,
        template: Template,
        selection: SafetyRadius,
        flight: Flight,
        *,
        nearest: int = 3,
        report_lifetime_s: float = 2.0,
    ) -> None:
        self.template, self.flight, self.nearest = template, flight, nearest
        self.report_lifetime_s = report_lifetime_s
        self.control_set = ControlSet(selection)

    def step(self, detections: Detections, reports: Sequence[UnitReport] = ()) -> Decision:
        """Decide on one image, given the last report heard from each other unit."""
        seen = detections.select(self.template.ids)
        reports = [r for r in reports if r.time_s >= detections.time_s - self.report_lifetime_s]
        controlled = self.control_set.update(seen, reports)
        try:
            goals = motion_goals(
                seen,
                controlled,
                self.template,
                shared_ids=shared_ids(controlled, reports),
                nearest=self.nearest,
            )
        except DegenerateSetError:
            goals = None
        report = UnitReport(
            unit_id=seen.unit_id,
            time_s=seen.time_s,
            image_size_px=seen.image_size_px,
            ids=seen.ids,
            points_px=seen.centers_px,
            controlled_ids=controlled,
            secure_ids=self.control_set.secure(seen),
        )
        return Decision(goals, report, self.flight.command(seen, controlled, reports))
