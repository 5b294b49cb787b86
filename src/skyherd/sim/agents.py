"""The minds of a scenario's units and robots, as its file asks for them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control import (
    AerialController,
    AvoidanceRule,
    BodyRule,
    Decision,
    Follow,
    GoalInboxes,
    GroundMap,
    Hover,
    HybridRule,
    KeepInView,
    MarkerGains,
    NeighborMemory,
    Perimeter,
    PixelGains,
    Rectifier,
    RoleRule,
    SafetyRadius,
    Selection,
    SizeRule,
    Team,
    Template,
    TreeRule,
    Wheels,
    newest_roles,
)
from skyherd.control.flight.laws import Flight
from skyherd.control.robots.unicycle import RobotLaw
from skyherd.control.topology.safety_radius import NO_ROBOTS
from skyherd.datasets import Mission, Scenario
from skyherd.datasets.configuration.models import SelectionModel
from skyherd.datasets.configuration.unit_models import FlightModel
from skyherd.geometry import ComplexArray, IntArray
from skyherd.messages import Detections, UnitReport
from skyherd.sim.baseline_laws import Law, bearing_only_law, complex_laplacian_law
from skyherd.sim.oracle_team import OracleTeam
from skyherd.sim.world import World

LAWS: Mapping[str, Callable[[ComplexArray, float], Law]] = {
    "complex-laplacian": complex_laplacian_law,
    "bearing-only": bearing_only_law,
}
"""From the literature: made from the shape on the ground and the gain."""

REPORT_LIFETIME_S = 2.0
REPORTS_MISSED = 5
"""A unit counts as silent after this long, and not before this many of its images."""

SLIPS = 3.0
"""Standard deviations of slip that robots reckon with."""


def make_flight(model: FlightModel, template: Template) -> Flight:
    """The motion law a scenario asks for."""
    yaw_rate = float(np.radians(model.yaw_rate_degps))
    if model.kind == "hover":
        return Hover(yaw_rate)
    if model.kind == "perimeter":
        return Perimeter(
            model.desired_radius, model.speed_mps, model.lateral_gain_mps, model.climb_gain_mps, yaw_rate
        )
    if model.kind == "keep-in-view":
        return KeepInView(
            template,
            model.desired_radius,
            model.lateral_gain_mps,
            model.climb_gain_mps,
            model.zoom_gain_ps,
            model.dead_band,
            model.separation_sides,
            model.least_side_px,
        )
    return Follow(model.desired_radius, model.lateral_gain_mps, model.climb_gain_mps, model.dead_band)


def make_gains(scenario: Scenario) -> RobotLaw:
    """The robots' gains a scenario asks for."""
    control = scenario.control
    if control.gains == "pixel":
        return PixelGains(control.k_v, control.k_omega, control.b_th)
    return MarkerGains(control.k, control.k_omega, control.b_th, scenario.marker.side_m)


def make_selection(model: SelectionModel) -> Selection:
    """The rule by which a scenario's units choose their sets."""
    free = SafetyRadius(model.radius, model.hysteresis, model.dwell_s)
    tree = TreeRule(
        model.share,
        model.radius,
        model.hysteresis,
        model.dwell_s,
        firm=model.firm,
        silence_s=model.silence_s,
    )
    rules: dict[str, Selection] = {"radius": free, "tree": tree, "radius-then-tree": HybridRule(free, tree)}
    return rules[model.kind]


@dataclass
class Mind:
    """One unit's mind: what its camera does to the ground is taken off, then it decides.

    Attributes:
        controller: decides on detections as an ideal camera would give them.
        rectifier: learns the camera from the markers; None if the scenario takes images as they are.
    """

    controller: AerialController
    rectifier: Rectifier | None

    def decide(self, seen: Detections, reports: Sequence[UnitReport]) -> Decision:
        """What to do after an image, given the last report heard from each other unit."""
        return self.controller.step(self.rectifier.rectify(seen) if self.rectifier else seen, reports)

    @property
    def ground_map(self) -> GroundMap:
        """The map that the last detections were taken through."""
        return self.rectifier.ground_map if self.rectifier else GroundMap()


def make_mind(mission: Mission, unit: int) -> Mind:
    """The mind of one unit of a mission, knowing nothing yet."""
    scenario = mission.scenario
    slowest_s = max(model.latency_s + REPORTS_MISSED / model.frame_rate_hz for model in scenario.units)
    controller = AerialController(
        mission.program,
        make_selection(scenario.selection),
        make_flight(scenario.units[unit].flight, mission.template),
        nearest=scenario.control.neighbors,
        report_lifetime_s=max(REPORT_LIFETIME_S, slowest_s),
        roles=make_roles(scenario),
        size=make_size(mission),
        bodies=make_bodies(mission),
    )
    return Mind(controller, Rectifier() if scenario.control.rectify else None)


class Agents:
    """The minds of all units.

    Attributes:
        minds: by unit.
        sets: S_j^c that each unit declared last.
    """

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        units = range(len(mission.scenario.units))
        self.minds = [make_mind(mission, unit) for unit in units]
        self.sets = {unit: NO_ROBOTS for unit in units}

    def lose(self, unit: int) -> None:
        """A unit is dead: what takes its place one day knows nothing."""
        self.minds[unit], self.sets[unit] = make_mind(self._mission, unit), NO_ROBOTS

    def decide(self, seen: Detections, reports: Sequence[UnitReport]) -> Decision:
        """What the unit whose image was taken does, given the last report heard from each other one."""
        decision = self.minds[seen.unit_id].decide(seen, reports)
        self.sets[seen.unit_id] = decision.report.controlled_ids
        return decision

    @property
    def roles(self) -> IntArray:
        """(N,) row of the template's point that each robot goes to, by the newest map."""
        words = [mind.controller.roles.reported for mind in self.minds]
        return newest_roles(words, self._mission.ids.size)


def make_roles(scenario: Scenario) -> RoleRule | None:
    """How units exchange the robots' places; None if they do not."""
    model = scenario.roles
    if not model.exchange:
        return None
    classes = None if model.classes is None else tuple(model.classes)
    return RoleRule(model.period_s, model.gain, classes=classes)


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
    obstacles = {obstacle.id: obstacle.radius_sides for obstacle in mission.scenario.obstacles}
    radius = mission.scenario.robots.body_radius_sides
    return BodyRule(radius, model.margin_sides, model.horizon_sides, obstacles)


def make_team(mission: Mission, world: World) -> Team | OracleTeam:
    """The robots' minds; the world is for those that follow a law from the literature."""
    scenario, gains = mission.scenario, make_gains(mission.scenario)
    if scenario.control.method != "similarity":
        shape = mission.template.points_of(mission.ids).conj()
        law = LAWS[scenario.control.method](shape, scenario.control.k)
        return OracleTeam(world, law, gains, make_wheels(scenario))
    units = np.arange(len(scenario.units))
    inboxes = GoalInboxes(mission.ids, units, scenario.robots.timeout_s, distances=gains.needs_distances)
    if not scenario.avoidance.on:
        return Team(inboxes, gains, make_wheels(scenario))
    bodies = np.union1d(mission.ids, mission.obstacle_ids)
    around = NeighborMemory(mission.ids, bodies, scenario.avoidance.lifetime_s)
    return Team(inboxes, gains, make_wheels(scenario), around, make_avoidance(scenario))


def make_wheels(scenario: Scenario) -> Wheels:
    """What a robot knows of its own wheels."""
    robots = scenario.robots
    return Wheels(robots.max_speed_mps, robots.max_turn_radps, robots.drive.axis_offset_m)


def make_avoidance(scenario: Scenario) -> AvoidanceRule:
    """What robots know of their own wheels, and of how fresh their news are."""
    robots, drive, step_s = scenario.robots, scenario.robots.drive, scenario.step_s
    brakes_s = robots.max_speed_mps / drive.max_accel_mps2 if drive.max_accel_mps2 else 0.0
    news_s = [unit.latency_s + 1 / unit.frame_rate_hz for unit in scenario.units]
    rates_hz = {unit.frame_rate_hz for unit in scenario.units}
    apart_s = step_s if len(rates_hz) > 1 else 1 / rates_hz.pop()  # between two images, of whatever units
    share = drive.gain_error + SLIPS * drive.slip
    wheel_mps = drive.wheel_step_mps / 2 + drive.dead_zone_mps + drive.gain_error * robots.max_speed_mps
    return AvoidanceRule(
        side_m=scenario.marker.side_m,
        wheels=make_wheels(scenario),
        nominal_age_s=max(news_s),
        superseded_age_s=min(unit.latency_s for unit in scenario.units) + apart_s,
        step_s=step_s,
        lag_s=np.ceil(drive.delay_s / step_s - 1e-9) * step_s + brakes_s,
        overshoot=share,
        creep_mps=drive.wheel_step_mps / 2,
        turn_error_radps=2 * wheel_mps / drive.track_m + SLIPS * drive.slip * robots.max_turn_radps,
        lifetime_s=scenario.avoidance.lifetime_s,
        detour=scenario.avoidance.detour,
    )
