"""Controllers of a scenario's units, made from the scenario."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from skyherd.assembly import (
    REPORT_LIFETIME_S,
    REPORTS_MISSED,
    make_body_rule,
    make_flight,
    make_roles,
    make_selection,
    make_size,
)
from skyherd.control import NO_ROBOTS, AerialController, Decision, Rectifier, TeamClock, newest_roles
from skyherd.datasets import Mission
from skyherd.geometry import IntArray
from skyherd.messages import Detections, UnitReport
from skyherd.sim.delays import min_report_delay_s
from skyherd.sim.physics import read_unit_clock
from skyherd.sim.robot_teams import make_camera_rule, make_lead_rule


def make_controller(mission: Mission, unit: int) -> AerialController:
    """Make a controller for one unit of a mission, without any memory."""
    scenario = mission.scenario
    slowest_s = max(model.latency_s + REPORTS_MISSED / model.frame_rate_hz for model in scenario.units)
    range_m = scenario.network.range_m
    radio_range_sides = None if range_m is None else range_m / scenario.marker.side_m
    return AerialController(
        mission.schedule,
        make_selection(scenario.selection),
        make_flight(scenario.units[unit].flight, mission.template, radio_range_sides),
        rectifier=Rectifier() if scenario.control.rectify else None,
        nearest=scenario.control.neighbors,
        report_lifetime_s=max(REPORT_LIFETIME_S, slowest_s),
        roles=make_roles(scenario.roles),
        size=make_size(scenario.size, mission.template, scenario.marker.side_m),
        bodies=make_body_rule(scenario.avoidance, scenario.robots.body_radius_sides, scenario.obstacles),
        clock=TeamClock(min_report_delay_s(scenario)) if scenario.clocks_differ else None,
        camera=make_camera_rule(scenario) if scenario.control.camera_check else None,
        lead=make_lead_rule(scenario, unit),
        asks_turns=scenario.control.tell_apart,
    )


ControllerFactory = Callable[[Mission, int], AerialController]
"""Function that makes a new controller for a unit of a mission."""


class UnitAgents:
    """Independent controllers of all units.

    Attributes:
        controllers: controllers by unit.
        sets: the control sets S_j^c that the units last declared.
    """

    def __init__(self, mission: Mission, controller_for: ControllerFactory) -> None:
        self._mission, self._controller_for = mission, controller_for
        units = range(len(mission.scenario.units))
        self.controllers = [controller_for(mission, unit) for unit in units]
        self.sets: dict[int, IntArray] = {unit: NO_ROBOTS for unit in units}
        self._unused = set(units)

    def reconfigure(self, mission: Mission) -> None:
        """Give all units the shapes of a changed mission, as an operator of the team does."""
        self._mission = mission
        for controller in self.controllers:
            controller.schedule = mission.schedule

    def lose(self, unit: int) -> None:
        """Mark a unit as dead. Its replacement starts with a new controller, without memory."""
        if unit not in self._unused:
            self.controllers[unit] = self._controller_for(self._mission, unit)
            self._unused.add(unit)
        self.sets[unit] = NO_ROBOTS

    def decide(self, detections: Detections, reports: Sequence[UnitReport]) -> Decision:
        """Return the decision of the unit that took the image, given the last received reports."""
        self._unused.discard(detections.unit_id)
        if self._mission.scenario.clocks_differ:
            shown_s = read_unit_clock(self._mission.scenario, detections.unit_id, detections.time_s)
            detections = replace(detections, time_s=shown_s)
        decision = self.controllers[detections.unit_id].step(detections, reports)
        self.sets[detections.unit_id] = decision.report.controlled_ids
        return decision

    @property
    def roles(self) -> IntArray:
        """Row (N,) of each robot's point in the template, by the newest map of any unit."""
        maps = [controller.roles.reported for controller in self.controllers]
        return newest_roles(maps, self._mission.ids.size)
