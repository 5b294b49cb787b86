"""Physics of a mission: world, drives and radio, made from its scenario.

World and drives take numbers and small parameter classes. Only this module converts a scenario into them. The
radio takes the scenario's network directly.
"""

from collections.abc import Callable

import numpy as np

from skyherd.datasets import Mission, Scenario
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.geometry import Array
from skyherd.sim.drive import Drive, DriveParameters
from skyherd.sim.network import Network
from skyherd.sim.sway import Sway
from skyherd.sim.world import AutopilotLimits, Markers, UnitParameters, World

PPM = 1e-6
"""One millionth. Derived: by definition of ppm."""


def make_world(mission: Mission) -> World:
    """Make the world of a mission at its start."""
    scenario = mission.scenario
    return World(
        robots=Markers(mission.ids, mission.positions_m, mission.headings_rad),
        layout=mission.layout,
        side_m=scenario.marker.side_m,
        obstacles=Markers(mission.obstacle_ids, mission.obstacle_positions_m, mission.obstacle_headings_rad),
        drive=make_drive(scenario, mission.ids.size),
        units=[make_unit(scenario, number) for number in range(len(scenario.units))],
        autopilot=AutopilotLimits(
            min_height_m=scenario.autopilot.min_height_m,
            max_height_m=scenario.autopilot.max_height_m,
            max_speed_mps=scenario.autopilot.max_speed_mps,
            max_climb_mps=scenario.autopilot.max_climb_mps,
            max_yaw_rate_radps=np.radians(scenario.autopilot.max_yaw_rate_degps),
        ),
        radio_range_m=scenario.network.range_m,
        frame_loss=scenario.network.frame_loss,
    )


def read_unit_clock(scenario: Scenario, unit: int, time_s: float) -> float:
    """Return the reading of an aerial unit's clock, s, at a time of the world."""
    model = scenario.units[unit]
    return model.clock_offset_s + time_s * (1 + PPM * model.clock_drift_ppm)


def make_robot_clocks(scenario: Scenario, count: int) -> Callable[[float], Array]:
    """Return a function from the time of the world to the readings (N,) of the robots' clocks, s."""
    rng = generator(scenario.seed, RunStream.ROBOT_CLOCKS)
    offsets_s = scenario.robots.clock_offset_s * rng.uniform(-1, 1, count)
    rates = 1 + PPM * scenario.robots.clock_drift_ppm * rng.uniform(-1, 1, count)
    return lambda time_s: np.asarray(offsets_s + rates * time_s)


def make_drive(scenario: Scenario, count: int) -> Drive:
    """Make the drives of a scenario's `count` robots."""
    robots, model = scenario.robots, scenario.robots.drive
    parameters = DriveParameters(
        max_speed_mps=robots.max_speed_mps,
        max_turn_radps=robots.max_turn_radps,
        max_accel_mps2=model.max_accel_mps2 or np.inf,
        max_turn_accel_radps2=model.max_turn_accel_radps2 or np.inf,
        wheel_step_mps=model.wheel_step_mps,
        dead_zone_mps=model.dead_zone_mps,
        gain_error=model.gain_error,
        track_m=model.track_m,
        slip=model.slip,
        delay_s=model.delay_s,
        axis_offset_m=model.axis_offset_m,
    )
    return Drive(
        parameters,
        count,
        step_s=scenario.step_s,
        gain_rng=generator(scenario.seed, RunStream.WHEEL_GAINS),
        slip_rng=generator(scenario.seed, RunStream.WHEEL_SLIP),
    )


def make_unit(scenario: Scenario, number: int) -> UnitParameters:
    """Make an aerial unit of a scenario; its sway depends on the scenario's seed and the unit's number."""
    model, sway = scenario.units[number], None
    if model.sway is not None:
        rng = generator(scenario.seed, RunStream.SWAY, number)
        sway = Sway.draw(float(np.radians(model.sway.tilt_deg)), model.sway.period_s, rng)
    times_s, zooms = zip(*model.zoom, strict=True)
    return UnitParameters(
        camera=model.camera.make(),
        position_m=model.position_m,
        height_m=model.height_m,
        yaw_rad=float(np.radians(model.yaw_deg)),
        tilt_rad=(float(np.radians(model.tilt_deg[0])), float(np.radians(model.tilt_deg[1]))),
        zoom_times_s=times_s,
        zooms=zooms,
        zoom_range=model.zoom_range,
        sway=sway,
    )


def make_network(scenario: Scenario, rng: np.random.Generator) -> Network:
    """Make the radio of a scenario, with losses and delays drawn from `rng`."""
    return Network(scenario.network, rng, len(scenario.units))
