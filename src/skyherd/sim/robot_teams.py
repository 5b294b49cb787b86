"""Robots of a scenario: their control law, and their knowledge of their own drive and clock."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from skyherd.assembly import make_body_rule
from skyherd.control import (
    AvoidanceRule,
    CameraRule,
    GoalFollowers,
    GoalInboxes,
    LatencyCompensation,
    LeadRule,
    MarkerGains,
    NeighborMemory,
    PixelGains,
    RobotClocks,
    RobotLaw,
    RobotTeam,
    ShapeMotion,
    TeamClock,
    Wheels,
)
from skyherd.datasets import AvoidanceModel, Mission, Scenario, WheelsModel
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.errors import InputError
from skyherd.geometry import ComplexArray
from skyherd.sim.baseline_laws import BaselineLaw, Law, find_law
from skyherd.sim.delays import max_message_delay_s, min_message_delay_s, whole_steps
from skyherd.sim.oracle_team import Avoidance, News, OracleTeam
from skyherd.sim.physics import make_robot_clocks
from skyherd.sim.world import World

SLIP_DEVIATIONS = 3.0
"""Slip that robots allow for, standard deviations. Chosen: a robot slips more in one of 370 steps."""

TeamFactory = Callable[[Mission, World], RobotTeam]
"""Function that makes the robots of a mission; the world is for teams that use ground truth."""


def make_gains(scenario: Scenario) -> RobotLaw:
    """Return the robots' gains, in the paper's pixels or in marker sides."""
    control = scenario.control
    if control.gains == "pixel":
        return PixelGains(k_v=control.k_v, k_omega=control.k_omega, b_th=control.b_th)
    return MarkerGains(k=control.k, k_omega=control.k_omega, b_th=control.b_th, side_m=scenario.marker.side_m)


def make_team(mission: Mission, world: World) -> RobotTeam:
    """Make the robots: they follow the units' goals, or a law from the literature, which reads the world."""
    scenario, gains, wheels = mission.scenario, make_gains(mission.scenario), make_wheels(mission.scenario)
    if scenario.control.method != "similarity":
        return _make_oracle_team(mission, world, gains, wheels)
    units = np.arange(len(scenario.units))
    inboxes = GoalInboxes(mission.ids, units, scenario.robots.timeout_s, distances=gains.needs_distances)
    compensation = make_latency_compensation(scenario, mission.ids.size)
    clocks = make_clocks(scenario, mission.ids.size)
    if not scenario.avoidance.on:
        return GoalFollowers(inboxes, gains, wheels, latency_compensation=compensation, clocks=clocks)
    bodies = np.union1d(mission.ids, mission.obstacle_ids)
    neighbors = NeighborMemory(
        mission.ids,
        bodies,
        scenario.avoidance.lifetime_s,
        max_speed_sides_ps=wheels.max_speed_mps / scenario.marker.side_m,
    )
    return GoalFollowers(
        inboxes,
        gains,
        wheels,
        neighbors=neighbors,
        avoidance=make_avoidance(scenario),
        latency_compensation=compensation,
        clocks=clocks,
    )


def _make_oracle_team(mission: Mission, world: World, gains: RobotLaw, wheels: Wheels) -> OracleTeam:
    """Make robots that follow a law from the literature, or a user-defined one.

    Raises:
        InputError: the law cannot be imported, or needs the size of the shape, which the scenario lacks.
    """
    scenario = mission.scenario
    method, found = scenario.control.method, find_law(scenario.control.method)
    if found.needs_size and scenario.size.unit_m is None:
        raise InputError(f"control.method {method}", "the shape has no size", "size.unit_m, in metres")
    news = News(
        noise_m=scenario.control.told_noise_m,
        loss=scenario.network.message_loss,
        lifetime_s=scenario.robots.timeout_s,
        rng=generator(scenario.seed, RunStream.REPORTED_POSITIONS),
    )
    shape = shape_m(mission)
    return OracleTeam(
        world,
        found.make(shape, scenario.control.k),
        gains,
        wheels,
        news,
        avoidance=_make_oracle_avoidance(scenario, world),
        lead=_make_lead(mission, found),
        free_shape=shape if found.has_free_roles else None,
    )


def _make_lead(mission: Mission, law: BaselineLaw) -> Callable[[float], Law] | None:
    """Return the law that moves the shape at a time; None if it rests."""
    if law.move is None or not mission.scenario.template.motion:
        return None
    shape, move = shape_m(mission), law.move
    arms = shape - shape.mean()
    radius = np.sqrt(np.mean(np.abs(arms) ** 2))

    @cache
    def law_of(motion: ShapeMotion) -> Law:
        # The ground's frame is mirrored against the image's.
        translation = complex(motion.right_ps, -motion.down_ps) * radius
        return move(shape, translation + complex(motion.growth_ps, -motion.turn_radps) * arms)

    return lambda time_s: law_of(mission.schedule.motion_at(time_s))


def _make_oracle_avoidance(scenario: Scenario, world: World) -> Avoidance | None:
    """Make the avoidance of robots that receive positions at each step; None if it is off."""
    bodies = make_body_rule(scenario.avoidance, scenario.robots.body_radius_sides, scenario.obstacles)
    if bodies is None:
        return None
    step_s = scenario.step_s
    timing = Timing(
        nominal_age_s=0.0,
        superseded_age_s=step_s,
        step_s=step_s,
        delay_s=whole_steps(scenario.robots.drive.delay_s, step_s),
        clock_margin_s=0.0,
    )
    rule = make_avoidance_rule(
        scenario.avoidance,
        scenario.robots.drive,
        make_wheels(scenario),
        side_m=scenario.marker.side_m,
        timing=timing,
    )
    return Avoidance(world, bodies, rule)


def shape_m(mission: Mission) -> ComplexArray:
    """Return the shape (N,) on the ground, in metres if `size.unit_m` is given, else in template units."""
    return mission.template.points_of(mission.ids).conj() * (mission.scenario.size.unit_m or 1.0)


def make_clocks(scenario: Scenario, count: int) -> RobotClocks | None:
    """Make the clocks by which `count` robots estimate the age of messages; None if all clocks agree."""
    if not scenario.clocks_differ:
        return None
    team = TeamClock(min_message_delay_s(scenario), count, listens=True)
    return RobotClocks(make_robot_clocks(scenario, count), team)


def make_clock_margin_s(scenario: Scenario) -> float:
    """Return the maximum error, s, of a message's age by a robot's estimate of the team's time.

    It is the difference of the delays of the slowest and the fastest messages; 0 if all clocks agree.
    """
    if not scenario.clocks_differ:
        return 0.0
    return max_message_delay_s(scenario) - min_message_delay_s(scenario)


def make_latency_compensation(scenario: Scenario, count: int) -> LatencyCompensation | None:
    """Make the latency compensation of `count` robots; None if the scenario disables it."""
    if not scenario.control.latency_compensation:
        return None
    drive = scenario.robots.drive
    slowest_s = max(model.latency_s for model in scenario.units)
    return LatencyCompensation(
        count,
        scenario.marker.side_m,
        axis_offset_m=drive.axis_offset_m,
        delay_s=whole_steps(drive.delay_s, scenario.step_s),
        memory_s=scenario.robots.timeout_s + slowest_s + scenario.network.delay_s,
    )


def make_wheels(scenario: Scenario) -> Wheels:
    """Return the kinematics and limits of the robots' wheels."""
    robots = scenario.robots
    return Wheels(robots.max_speed_mps, robots.max_turn_radps, robots.drive.axis_offset_m)


def make_avoidance(scenario: Scenario) -> AvoidanceRule:
    """Return the speed bound of a scenario's robots, from their wheels and the ages of messages."""
    drive, step_s = scenario.robots.drive, scenario.step_s
    rates_hz = {unit.frame_rate_hz for unit in scenario.units}
    apart_s = step_s if len(rates_hz) > 1 else 1 / rates_hz.pop()  # minimum time between images of two units
    timing = Timing(
        nominal_age_s=max(unit.latency_s + 1 / unit.frame_rate_hz for unit in scenario.units),
        superseded_age_s=min(unit.latency_s for unit in scenario.units) + apart_s,
        step_s=step_s,
        delay_s=whole_steps(drive.delay_s, step_s),
        clock_margin_s=make_clock_margin_s(scenario),
    )
    return make_avoidance_rule(
        scenario.avoidance, drive, make_wheels(scenario), side_m=scenario.marker.side_m, timing=timing
    )


def make_camera_rule(scenario: Scenario) -> CameraRule | None:
    """Return the response of a scenario's robots to goals; None if they follow another law."""
    if scenario.control.method != "similarity":
        return None
    step_s, drive = scenario.step_s, scenario.robots.drive
    brakes_s = scenario.robots.max_speed_mps / drive.max_accel_mps2 if drive.max_accel_mps2 else 0.0
    slowest_s = max(1 / unit.frame_rate_hz for unit in scenario.units)
    return CameraRule(
        make_gains(scenario),
        side_m=scenario.marker.side_m,
        max_speed_mps=scenario.robots.max_speed_mps,
        lag_s=max_message_delay_s(scenario) + slowest_s + step_s + drive.delay_s + brakes_s / 2,
        avoidance=make_avoidance(scenario) if scenario.avoidance.on else None,
    )


def make_lead_rule(scenario: Scenario, unit: int) -> LeadRule | None:
    """Return the response of a scenario's robots by which a unit leads a moving shape; None if it rests."""
    if not scenario.template.motion:
        return None
    control, model = scenario.control, scenario.units[unit]
    age_s = whole_steps(model.latency_s + scenario.network.delay_s / 2, scenario.step_s)
    age_s += 1 / (2 * model.frame_rate_hz) - scenario.step_s / 2 + scenario.robots.drive.delay_s
    return LeadRule(
        scenario.marker.side_m,
        control.k,
        turn_lag_s=0.0 if scenario.robots.drive.axis_offset_m else 1 / control.k_omega,
        age_s=age_s if control.latency_compensation else 0.0,
    )


@dataclass(frozen=True)
class Timing:
    """Ages of messages, and durations of commands, under the attribute names of `AvoidanceRule`.

    Attributes:
        nominal_age_s: maximum age of a message without losses.
        superseded_age_s: age above which a newer message may exist.
        step_s: duration of a command.
        delay_s: time from a command to its effect.
        clock_margin_s: maximum error by which a message is older than the robot's clock shows.
        bearing_s: possible heading error, expressed as time of turning at the maximum rate.
        is_synchronous: True if all robots decide at the same instants.
    """

    nominal_age_s: float
    superseded_age_s: float
    step_s: float
    delay_s: float
    clock_margin_s: float
    bearing_s: float = 0.0
    is_synchronous: bool = True


RETREAT_SHARE = 0.5
"""Share of the margin that a robot may use up while it leaves a body. Chosen: the other half remains for the
motion of the other body."""


def make_avoidance_rule(
    model: AvoidanceModel, drive: WheelsModel, wheels: Wheels, *, side_m: float, timing: Timing
) -> AvoidanceRule:
    """Return the speed bound of simulated and live robots.

    Args:
        model: settings of collision avoidance.
        drive: wheel errors and acceleration limit.
        wheels: limits of the wheels.
        side_m: side of the robots' markers.
        timing: ages of messages, and durations of commands.
    """
    brakes_s = wheels.max_speed_mps / drive.max_accel_mps2 if drive.max_accel_mps2 else 0.0
    wheel_mps = drive.wheel_step_mps / 2 + drive.dead_zone_mps + drive.gain_error * wheels.max_speed_mps
    lag_s = timing.delay_s + brakes_s
    return AvoidanceRule(
        side_m=side_m,
        wheels=wheels,
        nominal_age_s=timing.nominal_age_s,
        superseded_age_s=timing.superseded_age_s,
        step_s=timing.step_s,
        lag_s=lag_s,
        brakes_s=brakes_s,
        overshoot=drive.gain_error + SLIP_DEVIATIONS * drive.slip,
        creep_mps=drive.wheel_step_mps / 2,
        turn_error_radps=2 * wheel_mps / drive.track_m + SLIP_DEVIATIONS * drive.slip * wheels.max_turn_radps,
        clock_margin_s=timing.clock_margin_s,
        line_s=0.0 if timing.is_synchronous else timing.step_s + lag_s,
        bearing_error_rad=wheels.max_turn_radps * timing.bearing_s,
        lifetime_s=model.lifetime_s,
        detour=model.detour,
        retreat_sides=RETREAT_SHARE * model.margin_sides,
    )
