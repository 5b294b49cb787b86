"""The loop: images in, formation out. Everything else hangs off the steps that it yields."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import floor

import numpy as np

from skyherd.control import GroundMap
from skyherd.control.aerial_controller import Decision
from skyherd.datasets import Mission, Scenario
from skyherd.geometry import IntArray
from skyherd.messages import FlightCommand, VelocityCommand
from skyherd.sim.agents import Agents, make_team
from skyherd.sim.perception import Perception, Sight, make_perception
from skyherd.sim.physics import make_network, make_world
from skyherd.sim.truth_metrics import TruthMetrics, TruthObserver
from skyherd.sim.world import Fleet


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
    others hold still; `roles` (N,) the row of the template's point that each robot goes to.
    """

    time_s: float
    positions_m: np.ndarray
    headings_rad: np.ndarray
    fleet: Fleet
    frames: dict[int, UnitFrame]
    command: VelocityCommand
    commanded_ids: IntArray
    control_sets: dict[int, IntArray]
    metrics: TruthMetrics
    roles: IntArray

    def without_images(self) -> "Step":
        """The same step, less what takes the memory."""
        frames = {
            unit: replace(frame, sight=replace(frame.sight, image=None))
            for unit, frame in self.frames.items()
        }
        return replace(self, frames=frames)


def run_steps(mission: Mission, perception: Perception | None = None) -> Iterator[Step]:
    """Run a mission, yielding each step as it is decided and before the world moves.

    The same mission gives the same steps: every random draw comes from the scenario's seed.
    """
    scenario = mission.scenario
    sight_rng, network_rng, frame_rng = (np.random.default_rng([scenario.seed, part]) for part in (1, 2, 3))
    world, observer = make_world(mission), TruthObserver(mission.template, mission.ids)
    perception = perception or make_perception(mission, sight_rng)
    network = make_network(scenario, network_rng)
    agents, team, lost = Agents(mission), make_team(mission, world), scenario.network.frame_loss
    for tick in range(round(scenario.duration_s / scenario.step_s) + 1):
        time_s = tick * scenario.step_s
        frames, dead = {}, dead_units(scenario, time_s)
        for unit in dead:
            agents.lose(unit)
            network.forget(unit)
            world.fly(FlightCommand(unit, np.zeros(2), 0.0, 0.0))
        shot = [unit for unit in _due(scenario, tick, dead) if frame_rng.random() >= lost]
        hearers = world.in_range()
        for unit, sight in zip(shot, perception.look(world, shot, time_s), strict=True):
            decision = agents.decide(sight.detections, list(network.reports[unit].values()))
            arrival_s = time_s + scenario.units[unit].latency_s
            to_robots = decision.goals, decision.proximity
            network.send(to_robots, decision.report, arrival_s, hearers[unit] if hearers else None)
            world.fly(decision.flight)
            frames[unit] = UnitFrame(sight, decision, agents.minds[unit].ground_map)
        for message, heard in network.deliver(time_s):
            team.receive(message, time_s, heard)
        command = world.limit(team.command(time_s))
        shape = mission.shape_at(time_s, agents.roles)
        yield Step(
            time_s=time_s,
            positions_m=world.positions_m,
            headings_rad=world.headings_rad,
            fleet=world.fleet,
            frames=frames,
            command=command,
            commanded_ids=team.commanded_ids(time_s),
            control_sets=dict(agents.sets),
            metrics=observer.observe(world.positions_m, agents.sets, dead, shape),
            roles=agents.roles,
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
        return floor(ticks * step * rate_hz + 1e-9)

    return [
        unit
        for unit, model in enumerate(scenario.units)
        if unit not in dead
        and (tick == 0 or shots(tick, model.frame_rate_hz) > shots(tick - 1, model.frame_rate_hz))
    ]
