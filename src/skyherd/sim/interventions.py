"""Interventions: changes of a running simulation, made by the loop between two steps.

Each change goes to the part that owns the value: places and cameras to the world, losses and delays to the
radio, gains to the robots. A new shape is part of the mission, which units get as their configuration.
Controllers notice all other changes in their detections and messages alone.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyherd.control import GoalFollowers, RobotTeam
from skyherd.datasets import (
    CameraIntervention,
    ControlIntervention,
    CoverIntervention,
    Intervention,
    NetworkIntervention,
    RobotIntervention,
    Scenario,
    UnitIntervention,
)
from skyherd.errors import InputError
from skyherd.sim.network import Network
from skyherd.sim.physics import make_unit
from skyherd.sim.robot_teams import make_gains
from skyherd.sim.world import World


@dataclass(frozen=True)
class Simulation:
    """The parts of a running simulation."""

    world: World
    network: Network
    team: RobotTeam


def intervene(intervention: Intervention, scenario: Scenario, simulation: Simulation) -> None:
    """Make a change now.

    Failures of units and shapes are not made here: the loop reads them from the mission at each step.

    Args:
        intervention: the change.
        scenario: the scenario with the settings that this and all earlier interventions have made.
        simulation: what is changed.

    Raises:
        InputError: the robots are not those of the scenario, and take no gains.
    """
    world = simulation.world
    match intervention:
        case UnitIntervention():
            _place_unit(world, intervention)
            world.change_unit(intervention.unit, make_unit(scenario, intervention.unit))
        case CameraIntervention():
            unit, changes = intervention.unit, intervention.changes
            world.change_unit(unit, make_unit(scenario, unit))
            world.frame_losses[unit] = changes.get("frame_loss", world.frame_losses[unit])
            imaging = {key: changes[key] for key in vars(world.imaging[unit]) if key in changes}
            world.imaging[unit] = replace(world.imaging[unit], **imaging)
        case RobotIntervention():
            _place_robot(world, intervention)
        case CoverIntervention():
            change = world.covered_ids.add if intervention.covered else world.covered_ids.discard
            change(intervention.marker)
        case NetworkIntervention():
            simulation.network.model = scenario.network
        case ControlIntervention():
            if not isinstance(simulation.team, GoalFollowers):
                raise InputError("interventions", "robots of your own take no gains", "no kind 'control'")
            simulation.team.gains = make_gains(scenario)


def _place_unit(world: World, intervention: UnitIntervention) -> None:
    pose = world.camera_pose(intervention.unit)
    yaw_rad = pose.yaw_rad if intervention.yaw_deg is None else float(np.radians(intervention.yaw_deg))
    height_m = pose.height_m if intervention.height_m is None else intervention.height_m
    world.place_unit(intervention.unit, intervention.position_m or pose.position_m, height_m, yaw_rad)


def _place_robot(world: World, intervention: RobotIntervention) -> None:
    row = int(np.flatnonzero(world.ids == intervention.robot)[0])
    heading_rad = float(world.headings_rad[row])
    if intervention.heading_deg is not None:
        heading_rad = float(np.radians(intervention.heading_deg))
    position_m = intervention.position_m or world.positions_m[row]
    world.place_robot(intervention.robot, position_m, heading_rad)
