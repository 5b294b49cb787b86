"""Closed control loop from images to formation. All outputs derive from the steps that it yields."""

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from math import floor

import numpy as np

from skyherd.control import Decision
from skyherd.datasets import Intervention, Mission, Scenario
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.geometry import IntArray
from skyherd.messages import TIME_TOLERANCE_S, FlightCommand, VelocityCommand
from skyherd.messages.checks import check_kind
from skyherd.messages.short_repr import short_repr
from skyherd.sim.agents import ControllerFactory, UnitAgents, make_controller
from skyherd.sim.faulty_cameras import with_camera_faults
from skyherd.sim.fused_markers import with_fused_markers
from skyherd.sim.interventions import Simulation, intervene
from skyherd.sim.perception import make_run_perception
from skyherd.sim.physics import make_network, make_world
from skyherd.sim.position_errors import with_position_errors
from skyherd.sim.robot_teams import TeamFactory, make_team
from skyherd.sim.sight import Perception, Sight
from skyherd.sim.told_apart import with_robots_told_apart
from skyherd.sim.truth_metrics import TruthMetrics, TruthObserver
from skyherd.sim.world import Fleet

FRAME_ROUNDING = 1e-9
"""Tolerance by which a tick may fall short of a frame time, as a share of it. Derived: exceeds the rounding
of a tick's time."""


@dataclass(frozen=True)
class UnitFrame:
    """One unit's image and its decision.

    Attributes:
        sight: camera output, with the detections as the detector returned them.
        decision: output of the unit's controller, with the detections that it accepted.
    """

    sight: Sight
    decision: Decision

    __repr__ = short_repr


@dataclass(frozen=True)
class Step:
    """State of the system at one instant, before the world moves on.

    Attributes:
        time_s: simulated time.
        positions_m: (N, 2) the robots' markers on the ground.
        headings_rad: (N,) counter-clockwise from +x.
        fleet: places, heights, yaws, tilts and zooms of the units.
        frames: frame of each unit whose image was taken now and not lost.
        command: what the robots do until the next step.
        commanded_ids: robots with a goal that is not stale; the others stand still.
        control_sets: S_j^c of each unit, as it declared it last.
        metrics: ground-truth metrics of formation and topology.
        roles: (N,) template row assigned to each robot.
        interventions: changes that were made to the simulation since the last step.
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
    interventions: tuple[Intervention, ...] = ()

    __repr__ = short_repr

    def without_images(self) -> "Step":
        """Return the same step without images, which take nearly all of its memory."""
        frames = {
            unit: replace(frame, sight=replace(frame.sight, image=None))
            for unit, frame in self.frames.items()
        }
        return replace(self, frames=frames)


Requests = Callable[[float], Sequence[Intervention]]
"""Function from the time of a step, s, to the interventions that an operator asks for before it."""


@dataclass(frozen=True)
class Overruling:
    """Commands that the caller of `run_steps` sends in place of those of a step.

    Attributes:
        wheels: command of all robots, which their drives limit; None for the step's own.
        flights: commands of aerial units, which their autopilots limit. Failed units ignore theirs.
    """

    wheels: VelocityCommand | None = None
    flights: Sequence[FlightCommand] = ()


def no_requests(time_s: float) -> Sequence[Intervention]:
    """Ask for no interventions besides those of the scenario."""
    return ()


def run_steps(
    mission: Mission,
    perception: Perception | None = None,
    *,
    controller_for: ControllerFactory = make_controller,
    team_for: TeamFactory = make_team,
    requests: Requests = no_requests,
) -> Generator[Step, Overruling | None, None]:
    """Run a mission and yield each step after its decisions, before the world moves.

    The same mission gives the same steps, since every random draw derives from the scenario's seed. A caller
    may `send` other commands for the motion that follows a step.

    Args:
        mission: what to run.
        perception: source of each unit's detections of markers; by default the scenario's.
        controller_for: factory of a unit's controller (mission, unit); called at the start and in each
            outage.
        team_for: factory of the robots (mission, world).
        requests: interventions of an operator, called once before each step. The loop sets their times. A
            run of the scenario with them in `interventions` gives the same steps.

    Raises:
        InputError: `mission` is not a Mission, or a requested intervention is impossible.
    """
    check_kind("run_steps: mission", mission, Mission, "a Mission, as load_mission returns it")
    scenario = mission.scenario
    frame_rng = generator(scenario.seed, RunStream.LOST_FRAMES)
    world, observer = make_world(mission), TruthObserver(mission.template, mission.ids)
    perception = with_position_errors(perception or make_run_perception(mission), mission)
    perception = with_fused_markers(perception, mission)
    perception = with_robots_told_apart(with_camera_faults(perception, mission), mission)
    network = make_network(scenario, generator(scenario.seed, RunStream.MESSAGES))
    agents, team = UnitAgents(mission, controller_for), team_for(mission, world)
    simulation = Simulation(world, network, team)
    waiting = deque(scenario.interventions_in_order)
    for tick in range(round(scenario.duration_s / scenario.step_s) + 1):
        time_s = tick * scenario.step_s
        asked = [request.model_copy(update={"at_s": time_s}) for request in requests(time_s)]
        mission = mission.with_interventions(asked)
        due = [*_due(waiting, time_s), *asked]
        for intervention in due:
            intervene(intervention, mission.scenario_at(time_s), simulation)
        if asked:
            agents.reconfigure(mission)
        frames, dead = {}, mission.scenario.dead_units(time_s)
        for unit in dead:
            agents.lose(unit)
            network.forget(unit)
            world.fly(FlightCommand.hold(unit))
        taken = _units_with_frame(scenario, tick, dead)
        kept = [unit for unit in taken if frame_rng.random() >= world.frame_losses[unit]]
        network.connect(world.in_range(), dead)
        for unit, sight in zip(kept, perception.look(world, kept, time_s), strict=True):
            decision = agents.decide(sight.detections, list(network.reports[unit].values()))
            arrival_s = time_s + scenario.units[unit].latency_s
            if not decision.suspicion:
                to_robots = decision.goals, decision.turns, decision.proximity
                network.send(to_robots, decision.report, arrival_s)
            world.fly(decision.flight)
            frames[unit] = UnitFrame(sight, decision)
        orders = team.decide(time_s, network.deliver(time_s))
        command = world.limit(orders.command)
        roles = agents.roles if orders.roles is None else orders.roles
        shape = mission.shape_at(time_s, roles)
        overruling = yield Step(
            time_s=time_s,
            positions_m=world.positions_m,
            headings_rad=world.headings_rad,
            fleet=world.fleet,
            frames=frames,
            command=command,
            commanded_ids=orders.commanded_ids,
            control_sets=dict(agents.sets),
            metrics=observer.observe(world.positions_m, agents.sets, dead, shape),
            roles=roles,
            interventions=tuple(due),
        )
        if overruling is not None:
            command = world.limit(overruling.wheels or command)
            for flight in overruling.flights:
                world.fly(FlightCommand.hold(flight.unit_id) if flight.unit_id in dead else flight)
        world.advance(command, time_s, scenario.step_s)


def _due(waiting: deque[Intervention], time_s: float) -> Iterator[Intervention]:
    """Remove and yield the interventions, in order, whose time has come."""
    while waiting and waiting[0].at_s <= time_s + TIME_TOLERANCE_S:
        yield waiting.popleft()


def _units_with_frame(scenario: Scenario, tick: int, dead: list[int]) -> list[int]:
    """Return the living units that take an image in this tick, each at its own frame rate."""
    step = scenario.step_s

    def frames_by(ticks: int, rate_hz: float) -> int:
        return floor(ticks * step * rate_hz + FRAME_ROUNDING)

    return [
        unit
        for unit, model in enumerate(scenario.units)
        if unit not in dead
        and (tick == 0 or frames_by(tick, model.frame_rate_hz) > frames_by(tick - 1, model.frame_rate_hz))
    ]
