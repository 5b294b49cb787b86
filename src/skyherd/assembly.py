"""Make the parts of a unit's controller from a configuration: flight, selection, roles, size and bodies.

The simulated loop and live units share these functions: a key means the same in a scenario and in a lab.
"""

from collections.abc import Sequence

import numpy as np

from skyherd.control import (
    BodyRule,
    FlightLaw,
    Follow,
    Hover,
    HybridSelection,
    KeepInView,
    Perimeter,
    RoleRule,
    SafetyRadius,
    SelectionPolicy,
    SizeRule,
    Template,
    TreeProtocol,
    TreeSettings,
)
from skyherd.datasets import (
    AvoidanceModel,
    FlightModel,
    ObstacleMarkerModel,
    RolesModel,
    SelectionModel,
    SizeModel,
)

REPORT_LIFETIME_S = 2.0
"""Age up to which a unit's report counts. Chosen: a dwell time; shorter, and lost reports are felt."""

REPORTS_MISSED = 5
"""A unit counts as silent no sooner than after this many of its images, however slow its camera is. Chosen:
with three of ten messages lost, five in a row are lost once in 400 times."""


def make_flight(model: FlightModel, template: Template, radio_range_sides: float | None = None) -> FlightLaw:
    """Make a new flight law as `units.flight` asks for it.

    Args:
        model: settings of the law.
        template: the shape of the team.
        radio_range_sides: radio range between units, marker sides; None for no limit.
    """
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
        border_sides=model.border_sides,
        radio_range_sides=np.inf if radio_range_sides is None else radio_range_sides,
        **gains,
    )


def make_selection(model: SelectionModel) -> SelectionPolicy:
    """Make a new policy for one unit, by which it chooses the robots that it controls."""
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


def make_roles(model: RolesModel) -> RoleRule | None:
    """Make the rule by which units exchange the robots' places, or None if they do not."""
    if not model.exchange:
        return None
    classes = None if model.classes is None else tuple(model.classes)
    return RoleRule(period_s=model.period_s, gain=model.gain, classes=classes)


def make_size(model: SizeModel, template: Template, side_m: float) -> SizeRule:
    """Make the bounds on the shape's size, in marker sides.

    Args:
        model: the size that is asked for.
        template: the shape.
        side_m: side of the markers, m.
    """
    if model.unit_m is not None:
        sides = template.spacing_px * model.unit_m / side_m
        return SizeRule(sides, sides)
    if model.spacing_sides is not None:
        return SizeRule(model.spacing_sides, model.spacing_sides)
    return SizeRule(model.min_spacing_sides)


def make_body_rule(
    model: AvoidanceModel, radius_sides: float, obstacles: Sequence[ObstacleMarkerModel]
) -> BodyRule | None:
    """Return the bodies that units report to robots, or None where robots are points.

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
