"""The loop: images in, formation out. Everything else hangs off the steps that it yields."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.control import (
    AerialController,
    Follow,
    FreeRule,
    GroundMap,
    Hover,
    Inboxes,
    MarkerGains,
    Perimeter,
    PixelGains,
    Rectifier,
    SafetyRadius,
    Selection,
    Serve,
    Template,
    TreeRule,
    robot_commands,
)
from skyherd.control.flight import Flight
from skyherd.control.robot_law import Gains
from skyherd.control.selection import NO_ROBOTS
from skyherd.control.unit import Decision
from skyherd.datasets import Mission, Scenario
from skyherd.datasets.models import FlightModel, SelectionModel
from skyherd.geometry import IntArray
from skyherd.messages import FlightCommand, VelocityCommand
from skyherd.network import Network
from skyherd.observer import Observation, Observer
from skyherd.perception import Perception, Sight, make_perception
from skyherd.world import Fleet, World

REPORT_LIFETIME_S = 2.0
REPORTS_MISSED = 5
"""A unit counts as silent after this long, and not before this many of its images."""


@dataclass(frozen=True)
class UnitFrame:
    """One unit's image, what it decided on it, and the map that it took its detections through before."""

    sight: Sight
    decision: Decision
    ground_map: GroundMap = field(default_factory=GroundMap)


@dataclass(frozen=True)
class Step:
    """All that happened at one instant, before the world moves on.

    `control_sets` are the units' S_j^c; `commanded_ids` the robots that follow a goal heard of late, the
    others hold still.
    """

    time_s: float
    positions_m: np.ndarray
    headings_rad: np.ndarray
    fleet: Fleet
    frames: dict[int, UnitFrame]
    command: VelocityCommand
    commanded_ids: IntArray
    control_sets: dict[int, IntArray]
    observation: Observation

    def without_images(self) -> "Step":
        """The same step, less what takes the memory."""
        frames = {
            unit: replace(frame, sight=replace(frame.sight, image=None))
            for unit, frame in self.frames.items()
        }
        return replace(self, frames=frames)


def make_flight(model: FlightModel, template: Template) -> Flight:
    """The motion law a scenario asks for."""
    yaw_rate = float(np.radians(model.yaw_rate_degps))
    if model.kind == "hover":
        return Hover(yaw_rate)
    if model.kind == "perimeter":
        return Perimeter(
            model.desired_radius, model.speed_mps, model.lateral_gain_mps, model.climb_gain_mps, yaw_rate
        )
    if model.kind == "serve":
        return Serve(
            template,
            model.desired_radius,
            model.lateral_gain_mps,
            model.climb_gain_mps,
            model.zoom_gain_ps,
            model.dead_band,
            model.separation_sides,
        )
    return Follow(model.desired_radius, model.lateral_gain_mps, model.climb_gain_mps, model.dead_band)


def make_gains(scenario: Scenario) -> Gains:
    """The robots' gains a scenario asks for."""
    control = scenario.control
    if control.gains == "pixel":
        return PixelGains(control.k_v, control.k_omega, control.b_th)
    return MarkerGains(control.k, control.k_omega, control.b_th, scenario.marker.side_m)


def make_selection(model: SelectionModel) -> Selection:
    """The rule by which a scenario's units choose their sets."""
    free = SafetyRadius(model.radius, model.hysteresis, model.dwell_s)
    tree = TreeRule(model.share, model.radius, model.hysteresis, model.dwell_s, silence_s=model.silence_s)
    rules: dict[str, Selection] = {"radius": free, "tree": tree, "radius-then-tree": FreeRule(free, tree)}
    return rules[model.kind]


def make_controller(mission: Mission, unit: int) -> AerialController:
    """The mind of one unit of a mission, knowing nothing yet."""
    scenario, template = mission.scenario, mission.template
    slowest_s = max(model.latency_s + REPORTS_MISSED / model.frame_rate_hz for model in scenario.units)
    return AerialController(
        template,
        make_selection(scenario.selection),
        make_flight(scenario.units[unit].flight, template),
        nearest=scenario.control.neighbors,
        report_lifetime_s=max(REPORT_LIFETIME_S, slowest_s),
    )


def run_steps(mission: Mission, perception: Perception | None = None) -> Iterator[Step]:
    """Run a mission, yielding each step as it is decided and before the world moves.

    The same mission gives the same steps: every random draw comes from the scenario's seed.
    """
    scenario = mission.scenario
    sight_rng, network_rng, frame_rng = (np.random.default_rng([scenario.seed, part]) for part in (1, 2, 3))
    world, observer = World(mission), Observer(mission.template, mission.ids)
    crew = [make_controller(mission, unit) for unit in range(len(scenario.units))]
    perception = perception or make_perception(mission, sight_rng)
    network = Network(scenario.network, network_rng, len(crew))
    rectifiers = [Rectifier() for _ in crew]
    gains, sets = make_gains(scenario), {unit: NO_ROBOTS for unit in range(len(crew))}
    inboxes = Inboxes(
        mission.ids, np.arange(len(crew)), scenario.robots.timeout_s, distances=gains.needs_distances
    )
    for tick in range(round(scenario.duration_s / scenario.step_s) + 1):
        time_s = tick * scenario.step_s
        frames = {}
        dead = dead_units(scenario, time_s)
        for unit in dead:
            crew[unit], rectifiers[unit] = make_controller(mission, unit), Rectifier()
            sets[unit] = NO_ROBOTS
            network.forget(unit)
            world.fly(FlightCommand(unit, np.zeros(2), 0.0, 0.0))
        for unit in _due(scenario, tick, dead):
            if frame_rng.random() < scenario.network.frame_loss:
                continue
            sight = perception.look(world, unit, time_s)
            seen = (
                rectifiers[unit].rectify(sight.detections) if scenario.control.rectify else sight.detections
            )
            decision = crew[unit].step(seen, list(network.reports[unit].values()))
            arrival_s = time_s + scenario.units[unit].latency_s
            network.send(decision.goals, decision.report, arrival_s, world.in_range(unit))
            world.fly(decision.flight)
            frames[unit] = UnitFrame(sight, decision, rectifiers[unit].ground_map)
            sets[unit] = decision.report.controlled_ids
        for goals, received in network.deliver(time_s):
            inboxes.receive(goals, time_s, received)
        command = world.limit(robot_commands(inboxes, gains, time_s))
        yield Step(
            time_s=time_s,
            positions_m=world.positions_m,
            headings_rad=world.headings_rad,
            fleet=world.fleet,
            frames=frames,
            command=command,
            commanded_ids=mission.ids[inboxes.fresh(time_s).any(axis=0)],
            control_sets=dict(sets),
            observation=observer.observe(world.positions_m, sets, dead),
        )
        world.advance(command, time_s, scenario.step_s)


def dead_units(scenario: Scenario, time_s: float) -> list[int]:
    """Units that are in an outage now."""
    return [
        unit
        for unit, model in enumerate(scenario.units)
        if any(start <= time_s < end for start, end in model.outages)
    ]


def _due(scenario: Scenario, tick: int, dead: list[int]) -> list[int]:
    """Living units whose next image falls in this tick: each keeps its own frame rate."""
    step = scenario.step_s

    def shots(ticks: int, rate_hz: float) -> int:
        return int(np.floor(ticks * step * rate_hz + 1e-9))

    return [
        unit
        for unit, model in enumerate(scenario.units)
        if unit not in dead
        and (tick == 0 or shots(tick, model.frame_rate_hz) > shots(tick - 1, model.frame_rate_hz))
    ]
