"""The minds of a scenario's units and robots, as its file asks for them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control import (
    AerialController,
    Decision,
    Follow,
    FreeRule,
    GroundMap,
    Hover,
    MarkerGains,
    Perimeter,
    PixelGains,
    Rectifier,
    SafetyRadius,
    Selection,
    Serve,
    Template,
    TreeRule,
)
from skyherd.control.flight import Flight
from skyherd.control.robot_law import Gains
from skyherd.datasets import Mission, Scenario
from skyherd.datasets.models import FlightModel, SelectionModel
from skyherd.messages import Detections, UnitReport

REPORT_LIFETIME_S = 2.0
REPORTS_MISSED = 5
"""A unit counts as silent after this long, and not before this many of its images."""


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
    scenario, template = mission.scenario, mission.template
    slowest_s = max(model.latency_s + REPORTS_MISSED / model.frame_rate_hz for model in scenario.units)
    controller = AerialController(
        template,
        make_selection(scenario.selection),
        make_flight(scenario.units[unit].flight, template),
        nearest=scenario.control.neighbors,
        report_lifetime_s=max(REPORT_LIFETIME_S, slowest_s),
    )
    return Mind(controller, Rectifier() if scenario.control.rectify else None)
