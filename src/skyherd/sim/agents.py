"""The controllers of a scenario's units, as the scenario's file asks for them."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from skyherd.control import (
    NO_ROBOTS,
    AerialController,
    BodyRule,
    Decision,
    FlightLaw,
    Follow,
    Hover,
    HybridSelection,
    KeepInView,
    Perimeter,
    Rectifier,
    RoleRule,
    SafetyRadius,
    SelectionPolicy,
    SizeRule,
    TeamClock,
    Template,
    TreeProtocol,
    TreeSettings,
    newest_roles,
)
from skyherd.datasets import (
    AvoidanceModel,
    FlightModel,
    Mission,
    ObstacleMarkerModel,
    Scenario,
    SelectionModel,
)
from skyherd.geometry import IntArray
from skyherd.messages import Detections, UnitReport
from skyherd.sim.delays import min_report_delay_s
from skyherd.sim.physics import read_unit_clock

REPORT_LIFETIME_S = 2.0
"""Age up to which a unit's report counts. Chosen: a dwell time; shorter, and lost reports are felt."""

REPORTS_MISSED = 5
"""A unit counts as silent no sooner than after this many of its images, however slow its camera is. Chosen:
with three of ten messages lost, five in a row are lost once in 400 times."""


def make_flight(model: FlightModel, template: Template) -> FlightLaw:
    """A new flight law as a scenario's `units.flight` asks for it."""
    yaw_rate_radps = float(np.radians(model.yaw_rate_degps))
    gains = {
        "desired_radius": model.desired_radius,
        "lateral_gain_mps": model.lateral_gain_mps,
        "climb_gain_mps": model.climb_gain_mps,
    }
    if model.kind == "hover":
        return Hover(yaw_rate_radps)
    if model.kind == "perimeter":
        return Perimeter(speed_mps=model.speed_mps, yaw_rate_radps=yaw_rate_radps, **gains)
    if model.kind == "follow":
        return Follow(dead_band=model.dead_band, **gains)
    return KeepInView(
        template,
        zoom_gain_ps=model.zoom_gain_ps,
        dead_band=model.dead_band,
        separation_sides=model.separation_sides,
        min_side_px=model.min_side_px,
        **gains,
    )


def make_selection(model: SelectionModel) -> SelectionPolicy:
    """A new policy for one unit, by which it chooses the robots that it controls."""
    overlapping = SafetyRadius(radius=model.radius, hysteresis=model.hysteresis, dwell_s=model.dwell_s)
    tree_settings = TreeSettings(
        share=model.share,
        radius=model.radius,
        hysteresis=model.hysteresis,
        dwell_s=model.dwell_s,
        firm=model.firm,
        silence_s=model.silence_s,
    )
    if model.kind == "radius":
        return overlapping
    if model.kind == "tree":
        return TreeProtocol(tree_settings)
    return HybridSelection(overlapping, tree_settings)


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
        roles=make_roles(scenario),
        size=make_size(mission),
        bodies=make_bodies(mission),
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


def make_roles(scenario: Scenario) -> RoleRule | None:
    """How units exchange the robots' places; None if they do not."""
    model = scenario.roles
    if not model.exchange:
        return None
    classes = None if model.classes is None else tuple(model.classes)
    return RoleRule(period_s=model.period_s, gain=model.gain, classes=classes)


def make_size(mission: Mission) -> SizeRule:
    """Bounds on the shape's size, in marker sides."""
    model, side_m = mission.scenario.size, mission.scenario.marker.side_m
    if model.unit_m is not None:
        sides = mission.template.spacing_px * model.unit_m / side_m
        return SizeRule(sides, sides)
    if model.spacing_sides is not None:
        return SizeRule(model.spacing_sides, model.spacing_sides)
    return SizeRule(model.min_spacing_sides)


def make_bodies(mission: Mission) -> BodyRule | None:
    """What units know of bodies; None where robots are points."""
    scenario = mission.scenario
    return make_body_rule(scenario.avoidance, scenario.robots.body_radius_sides, scenario.obstacles)


def make_body_rule(
    model: AvoidanceModel, radius_sides: float, obstacles: Sequence[ObstacleMarkerModel]
) -> BodyRule | None:
    """Return the bodies that units report to robots; None if avoidance is off.

    Args:
        model: how robots keep apart.
        radius_sides: radius of the robots' bodies, in marker sides.
        obstacles: markers that are obstacles.
    """
    if not model.on:
        return None
    return BodyRule(
        radius_sides=radius_sides,
        margin_sides=model.margin_sides,
        horizon_sides=model.horizon_sides,
        obstacles={obstacle.id: obstacle.radius_sides for obstacle in obstacles},
    )
