"""The controllers of a scenario's units, and its robots, as the scenario's file asks for them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from skyherd.control import (
    NO_ROBOTS,
    AerialController,
    AvoidanceRule,
    BodyRule,
    DeadReckoning,
    Decision,
    FlightLaw,
    Follow,
    GoalFollowers,
    GoalInboxes,
    Hover,
    HybridSelection,
    KeepInView,
    MarkerGains,
    NeighborMemory,
    Perimeter,
    PixelGains,
    Rectifier,
    RobotClocks,
    RobotLaw,
    RobotTeam,
    RoleRule,
    SafetyRadius,
    SelectionPolicy,
    SizeRule,
    TeamClock,
    Template,
    TreeProtocol,
    TreeRule,
    Wheels,
    newest_roles,
)
from skyherd.datasets import FlightModel, Mission, Scenario, SelectionModel
from skyherd.geometry import ComplexArray, IntArray
from skyherd.messages import Detections, UnitReport
from skyherd.sim.baseline_laws import Law, bearing_only_law, complex_laplacian_law
from skyherd.sim.oracle_team import OracleTeam
from skyherd.sim.physics import make_robot_clocks, read_unit_clock
from skyherd.sim.world import World

LAWS: Mapping[str, Callable[[ComplexArray, float], Law]] = {
    "complex-laplacian": complex_laplacian_law,
    "bearing-only": bearing_only_law,
}
"""Laws from the literature by the names of `control.method`, made from the shape on the ground and the
gain."""

REPORT_LIFETIME_S = 2.0
"""Age up to which a unit's report counts. Chosen: a dwell time; shorter, and lost reports are felt."""

REPORTS_MISSED = 5
"""A unit counts as silent no sooner than after this many of its images, however slow its camera is. Chosen:
with three of ten messages lost, five in a row are lost once in 400 times."""

SLIP_DEVIATIONS = 3.0
"""Standard deviations of slip that robots allow for. Chosen: a robot slips more in one step of 370."""

ROUNDING_STEPS = 1e-9
"""Share of a step by which a delay may exceed whole steps without costing another one: the rounding of a
quotient."""


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
        least_side_px=model.least_side_px,
        **gains,
    )


def make_gains(scenario: Scenario) -> RobotLaw:
    """The robots' gains, in the paper's pixels or in marker sides."""
    control = scenario.control
    if control.gains == "pixel":
        return PixelGains(k_v=control.k_v, k_omega=control.k_omega, b_th=control.b_th)
    return MarkerGains(k=control.k, k_omega=control.k_omega, b_th=control.b_th, side_m=scenario.marker.side_m)


def make_selection(model: SelectionModel) -> SelectionPolicy:
    """A new policy for one unit, by which it chooses the robots that it controls."""
    overlapping = SafetyRadius(radius=model.radius, hysteresis=model.hysteresis, dwell_s=model.dwell_s)
    tree_rule = TreeRule(
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
        return TreeProtocol(tree_rule)
    return HybridSelection(overlapping, tree_rule)


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
        clock=TeamClock(least_report_delay_s(scenario)) if scenario.clocks_differ else None,
    )


def least_report_delay_s(scenario: Scenario) -> float:
    """Least time, s, from an image to an image of another unit that takes in the report on it."""
    rates_hz = {unit.frame_rate_hz for unit in scenario.units}
    steps = np.floor(1 / (max(rates_hz) * scenario.step_s) + ROUNDING_STEPS) if len(rates_hz) == 1 else 1.0
    return max(float(steps) * scenario.step_s, min(unit.latency_s for unit in scenario.units))


ControllerFactory = Callable[[Mission, int], AerialController]
"""Makes a new controller for a unit of a mission."""

TeamFactory = Callable[[Mission, World], RobotTeam]
"""Makes the robots of a mission; the world is for teams that are given the truth."""


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
    return SizeRule(model.least_spacing_sides)


def make_bodies(mission: Mission) -> BodyRule | None:
    """What units know of bodies; None where robots are points."""
    model = mission.scenario.avoidance
    if not model.on:
        return None
    return BodyRule(
        radius_sides=mission.scenario.robots.body_radius_sides,
        margin_sides=model.margin_sides,
        horizon_sides=model.horizon_sides,
        obstacles={obstacle.id: obstacle.radius_sides for obstacle in mission.scenario.obstacles},
    )


def make_team(mission: Mission, world: World) -> RobotTeam:
    """The robots: they follow the units' goals, or a law from the literature, which is given the world."""
    scenario, gains, wheels = mission.scenario, make_gains(mission.scenario), make_wheels(mission.scenario)
    if scenario.control.method != "similarity":
        shape = mission.template.points_of(mission.ids).conj()
        law = LAWS[scenario.control.method](shape, scenario.control.k)
        return OracleTeam(world, law, gains, wheels)
    units = np.arange(len(scenario.units))
    inboxes = GoalInboxes(mission.ids, units, scenario.robots.timeout_s, distances=gains.needs_distances)
    motion = make_dead_reckoning(scenario, mission.ids.size)
    clocks = make_clocks(scenario, mission.ids.size)
    if not scenario.avoidance.on:
        return GoalFollowers(inboxes, gains, wheels, motion=motion, clocks=clocks)
    bodies = np.union1d(mission.ids, mission.obstacle_ids)
    neighbors = NeighborMemory(mission.ids, bodies, scenario.avoidance.lifetime_s)
    return GoalFollowers(
        inboxes,
        gains,
        wheels,
        neighbors=neighbors,
        avoidance=make_avoidance(scenario),
        motion=motion,
        clocks=clocks,
    )


def make_clocks(scenario: Scenario, count: int) -> RobotClocks | None:
    """How `count` robots tell the age of messages; None where all clocks agree."""
    if not scenario.clocks_differ:
        return None
    least_delay_s = min(unit.latency_s for unit in scenario.units)
    return RobotClocks(make_robot_clocks(scenario, count), TeamClock(least_delay_s, count, listens=True))


def _late_s(scenario: Scenario) -> float:
    """By how much, s, a message to a robot may take longer than the fastest ones, in whole steps."""
    latencies_s = [unit.latency_s for unit in scenario.units]
    late_s = max(latencies_s) + scenario.network.delay_s - min(latencies_s)
    return _whole_steps(late_s, scenario.step_s) + (scenario.step_s if late_s else 0.0)


def make_dead_reckoning(scenario: Scenario, count: int) -> DeadReckoning | None:
    """What `count` robots know of their own motion; None where they follow goals as they come."""
    if not scenario.control.compensate:
        return None
    drive = scenario.robots.drive
    slowest_s = max(model.latency_s for model in scenario.units)
    return DeadReckoning(
        count,
        scenario.marker.side_m,
        axis_offset_m=drive.axis_offset_m,
        delay_s=_whole_steps(drive.delay_s, scenario.step_s),
        memory_s=scenario.robots.timeout_s + slowest_s + scenario.network.delay_s,
    )


def _whole_steps(delay_s: float, step_s: float) -> float:
    """A drive's delay as the wheels keep it: rounded up to whole time steps."""
    return float(np.ceil(delay_s / step_s - ROUNDING_STEPS) * step_s)


def make_wheels(scenario: Scenario) -> Wheels:
    """What a robot knows of its own wheels."""
    robots = scenario.robots
    return Wheels(robots.max_speed_mps, robots.max_turn_radps, robots.drive.axis_offset_m)


def make_avoidance(scenario: Scenario) -> AvoidanceRule:
    """What the bound on robots' speed goes by: their own wheels, and how old their news may be."""
    robots, drive, step_s = scenario.robots, scenario.robots.drive, scenario.step_s
    brakes_s = robots.max_speed_mps / drive.max_accel_mps2 if drive.max_accel_mps2 else 0.0
    rates_hz = {unit.frame_rate_hz for unit in scenario.units}
    apart_s = step_s if len(rates_hz) > 1 else 1 / rates_hz.pop()  # between two images, of whatever units
    wheel_mps = drive.wheel_step_mps / 2 + drive.dead_zone_mps + drive.gain_error * robots.max_speed_mps
    return AvoidanceRule(
        side_m=scenario.marker.side_m,
        wheels=make_wheels(scenario),
        nominal_age_s=max(unit.latency_s + 1 / unit.frame_rate_hz for unit in scenario.units),
        superseded_age_s=min(unit.latency_s for unit in scenario.units) + apart_s,
        step_s=step_s,
        lag_s=_whole_steps(drive.delay_s, step_s) + brakes_s,
        overshoot=drive.gain_error + SLIP_DEVIATIONS * drive.slip,
        creep_mps=drive.wheel_step_mps / 2,
        turn_error_radps=2 * wheel_mps / drive.track_m + SLIP_DEVIATIONS * drive.slip * robots.max_turn_radps,
        clock_margin_s=_late_s(scenario) if scenario.clocks_differ else 0.0,
        lifetime_s=scenario.avoidance.lifetime_s,
        detour=scenario.avoidance.detour,
    )
