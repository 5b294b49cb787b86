"""The controllers of a scenario's units, as the scenario's file asks for them."""

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


def make_controller(mission: Mission, unit: int) -> AerialController:
    """A new controller for one unit of a mission; it has seen and received nothing yet."""
    scenario = mission.scenario
    slowest_s = max(model.latency_s + REPORTS_MISSED / model.frame_rate_hz for model in scenario.units)
    return AerialController(
        mission.schedule,
        make_selection(scenario.selection),
        make_flight(scenario.units[unit].flight, mission.template),
        rectifier=Rectifier() if scenario.control.rectify else None,
        nearest=scenario.control.neighbors,
        report_lifetime_s=max(REPORT_LIFETIME_S, slowest_s),
        roles=make_roles(scenario.roles),
        size=make_size(scenario.size, mission.template, scenario.marker.side_m),
        bodies=make_body_rule(scenario.avoidance, scenario.robots.body_radius_sides, scenario.obstacles),
        clock=TeamClock(min_report_delay_s(scenario)) if scenario.clocks_differ else None,
    )


ControllerFactory = Callable[[Mission, int], AerialController]
"""Makes a new controller for a unit of a mission."""


class UnitAgents:
    """The controllers of all units, which share nothing.

    Attributes:
        controllers: by unit.
        sets: S_j^c that each unit declared last.
    """

    def __init__(self, mission: Mission, controller_for: ControllerFactory) -> None:
        self._mission, self._controller_for = mission, controller_for
        units = range(len(mission.scenario.units))
        self.controllers = [controller_for(mission, unit) for unit in units]
        self.sets: dict[int, IntArray] = {unit: NO_ROBOTS for unit in units}
        self._unused = set(units)

    def lose(self, unit: int) -> None:
        """A unit is dead. What takes its place one day starts with a new controller, which knows nothing."""
        if unit not in self._unused:
            self.controllers[unit] = self._controller_for(self._mission, unit)
            self._unused.add(unit)
        self.sets[unit] = NO_ROBOTS

    def decide(self, detections: Detections, reports: Sequence[UnitReport]) -> Decision:
        """What the unit that took the image does, given the last report received from each other unit."""
        self._unused.discard(detections.unit_id)
        if self._mission.scenario.clocks_differ:
            shown_s = read_unit_clock(self._mission.scenario, detections.unit_id, detections.time_s)
            detections = replace(detections, time_s=shown_s)
        decision = self.controllers[detections.unit_id].step(detections, reports)
        self.sets[detections.unit_id] = decision.report.controlled_ids
        return decision

    @property
    def roles(self) -> IntArray:
        """(N,) row of the template's point that each robot goes to, by the newest map of any unit."""
        maps = [controller.roles.reported for controller in self.controllers]
        return newest_roles(maps, self._mission.ids.size)
