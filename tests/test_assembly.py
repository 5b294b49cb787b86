"""Assembly of a controller's parts from a configuration, equal for scenario and lab."""

import numpy as np
import pytest

from skyherd.assembly import make_body_rule, make_roles, make_size
from skyherd.control import RoleRule, SizeRule, Template
from skyherd.datasets import AvoidanceModel, ObstacleMarkerModel, RolesModel, SizeModel, load_mission
from skyherd.live.lab import load_lab, make_lab
from skyherd.sim.agents import make_controller

SQUARE = Template(np.arange(4), np.array([0, 2, 2 + 2j, 2j]))
"""Square whose nearest points are 2 units apart."""


@pytest.mark.parametrize(
    ("keys", "rule"),
    [
        ({}, SizeRule(0.0)),
        ({"min_spacing_sides": 3.0}, SizeRule(3.0)),
        ({"spacing_sides": 5.0}, SizeRule(5.0, 5.0)),
        ({"unit_m": 0.3}, SizeRule(4.0, 4.0)),  # 2 units of 0.3 m are 4 sides of 0.15 m
    ],
)
def test_size_of_model_is_in_marker_sides(keys, rule):
    made = make_size(SizeModel(**keys), SQUARE, side_m=0.15)
    assert (made.min_sides, made.max_sides) == pytest.approx((rule.min_sides, rule.max_sides))


def test_roles_and_bodies_are_none_by_default():
    assert make_roles(RolesModel()) is None
    assert make_roles(RolesModel(exchange=True, classes=[0, 1])) == RoleRule(
        period_s=1.0, gain=0.05, classes=(0, 1)
    )
    assert make_body_rule(AvoidanceModel(), 1.0, []) is None
    box = ObstacleMarkerModel(id=7, radius_sides=2.0)
    assert make_body_rule(AvoidanceModel(on=True), 1.5, [box]).obstacles == {7: 2.0}


@pytest.mark.smoke
def test_lab_and_scenario_make_the_same_size_and_roles():
    """A lab and a scenario with the same keys have controllers with equal rules; other keys differ."""
    tree = load_lab("star").model.model_dump(mode="json", exclude_none=True)
    tree["shape"] |= {"size": {"unit_m": 0.1}, "exchange": True}
    lab = make_lab(tree)
    side_m = lab.model.markers.side_m
    keys = ["size.unit_m=0.1", "roles.exchange=true", f"marker.side_m={side_m}"]
    mission = load_mission("star", keys)
    ours, theirs = lab.make_controller(0), make_controller(mission, 0)
    scale = lab.template.spacing_px / mission.template.spacing_px
    assert ours.size.min_sides == pytest.approx(theirs.size.min_sides * scale)
    assert ours.roles.rule == theirs.roles.rule
    assert make_controller(load_mission("star"), 0).size != theirs.size
