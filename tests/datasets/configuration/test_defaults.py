"""Library classes and scenario files have the same defaults."""

from dataclasses import MISSING, fields

import pytest

from skyherd.control import (
    AerialController,
    BodyRule,
    Follow,
    KeepInView,
    Perimeter,
    RoleRule,
    SafetyRadius,
    SizeRule,
    TreeSettings,
)
from skyherd.datasets.configuration.body_models import AvoidanceModel, RolesModel, SizeModel
from skyherd.datasets.configuration.models import ControlModel, SelectionModel
from skyherd.datasets.configuration.unit_models import FlightModel

PAIRS = [
    (SafetyRadius, SelectionModel, {}),
    (TreeSettings, SelectionModel, {}),
    (Follow, FlightModel, {}),
    (Perimeter, FlightModel, {}),
    (KeepInView, FlightModel, {}),
    (RoleRule, RolesModel, {}),
    (BodyRule, AvoidanceModel, {}),
    (SizeRule, SizeModel, {"min_sides": "min_spacing_sides"}),
]


@pytest.mark.parametrize(("made", "model", "names"), PAIRS, ids=lambda x: getattr(x, "__name__", ""))
def test_a_key_left_out_is_the_default_of_the_class(made, model, names) -> None:
    """The test covers all fields with a key of the model, under the same name or according to `names`."""
    compared = 0
    for field in fields(made):
        key = model.model_fields.get(names.get(field.name, field.name))
        if key is None or field.default is MISSING:
            continue
        assert key.default == field.default, field.name
        compared += 1
    assert compared, "nothing in common"


def test_neighbours_that_goals_name() -> None:
    default = AerialController.__init__.__kwdefaults__["nearest"]
    assert ControlModel.model_fields["neighbors"].default == default
