"""Every number of a scenario, a study and a data set spec has bounds, and values outside are refused.

The test walks the JSON schema of every model, so that it fails for a new key without bounds. Keys whose
values replace keys of a scenario have any type; the scenario checks them.
"""

import numpy as np
import pytest

import skyherd.live.lab
import skyherd.study.spec  # noqa: F401  (its models are subclasses of Model)
from skyherd.datasets import Model, load_mission
from skyherd.datasets.configuration.fields import MAX_MAGNITUDE, MIN_MAGNITUDE
from skyherd.datasets.labelled.spec import load_spec, make_spec
from skyherd.errors import InputError
from skyherd.loop import run_steps

ANYTHING = {
    ("Parts", "set"),
    ("Parts", "grid"),
    ("DrawModel", "choice"),
    ("TaskModel", "set"),
    ("StudySpec", "quick"),
}
"""Keys whose values have any type."""


def all_models(model=Model):
    for sub in model.__subclasses__():
        if sub.__module__.startswith("skyherd."):
            yield sub
            yield from all_models(sub)


def numbers(schema, at=()):
    """Yield every schema of a number within a schema, and the path to it."""
    if isinstance(schema, dict):
        if schema.get("type") in ("number", "integer"):
            yield at, schema
        for key, value in schema.items():
            if key != "default":
                yield from numbers(value, (*at, key))
    elif isinstance(schema, list):
        for index, value in enumerate(schema):
            yield from numbers(value, (*at, index))


@pytest.mark.parametrize("model", sorted(set(all_models()), key=lambda model: model.__name__))
def test_every_number_has_a_lower_and_an_upper_bound(model):
    for at, schema in numbers(model.model_json_schema()):
        low = schema.get("minimum", schema.get("exclusiveMinimum"))
        high = schema.get("maximum", schema.get("exclusiveMaximum"))
        assert low is not None and high is not None, (model.__name__, at)
        assert np.isfinite([float(low), float(high)]).all()
        assert max(abs(low), abs(high)) <= max(MAX_MAGNITUDE, 2**63), (model.__name__, at)


def test_all_models_are_walked():
    """Scenarios, studies and specs with all their parts, and the keys whose values have any type."""
    names = {model.__name__ for model in all_models()}
    assert {
        "Scenario",
        "UnitModel",
        "LabModel",
        "StudySpec",
        "DrawModel",
        "DatasetSpec",
        "CameraSpec",
    } <= names
    assert len(names) > 30
    untyped = {
        (model.__name__, name)
        for model in all_models()
        for name, field in model.model_fields.items()
        if "Any" in str(field.annotation) and name in model.__annotations__
    }
    assert untyped == ANYTHING


@pytest.mark.parametrize(
    ("scenario", "setting"),
    [
        ("star", "seed=18446744073709551616"),
        ("star", "seed=-1"),
        ("star", "step_s=1e-320"),
        ("star", "duration_s=1e-320"),
        ("star", "units.0.yaw_deg=1e308"),
        ("star", "units.0.flight.yaw_rate_degps=1e308"),
        ("star", "marker.side_m=1e-320"),
        ("star", "marker.side_m=1e-9"),
        ("star", "units.0.height_m=1e-320"),
        ("star", "units.0.frame_rate_hz=1e-320"),
        ("star", "units.0.zoom=[[0, 1e-320]]"),
        ("star", "units.0.camera.aspect=1e-320"),
        ("star", "units.0.camera.skew=1e300"),
        ("star", "robots.drive.wheel_step_mps=1e-320"),
        ("star", "robots.drive.axis_offset_m=1e-320"),
        ("star", "robots.drive.axis_offset_m=-1e-320"),
        ("star", "robots.drive.track_m=1e-320"),
        ("star", "robots.body_radius_sides=1e-320"),
        ("star", "selection.radius=1e-320"),
        ("star", "control.k=1e-320"),
        ("star", "control.neighbors=9999999999999999999999"),
        ("star", "sensor.gradient_deg=1e308"),
        ("star", "roles.classes=[99999999999999999999]"),
    ],
)
def test_a_number_beyond_its_bounds_is_refused_in_one_line(scenario, setting):
    key = setting.partition("=")[0].replace("*", "0")
    with pytest.raises(InputError, match=key.partition(".")[0]) as refusal:
        load_mission(scenario, [setting])
    assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 500


@pytest.mark.parametrize("value", [0.0, MIN_MAGNITUDE, 1e-6])
def test_a_quantity_of_zero_or_more_may_be_zero_or_small(value):
    assert load_mission("star", [f"robots.drive.wheel_step_mps={value}"])


def test_a_spec_with_numbers_beyond_their_bounds_is_refused():
    tree = load_spec("small").spec.model_dump()
    for key, value in (("seed", 2**64), ("images", 10**30)):
        with pytest.raises(InputError, match=key):
            make_spec(tree | {key: value})


def extremes(mission):
    """Yield path, minimum and maximum of each number of a scenario."""
    schema = type(mission.scenario).model_json_schema()
    for at, number in numbers(schema):
        low = number.get("minimum", number.get("exclusiveMinimum"))
        high = number.get("maximum", number.get("exclusiveMaximum"))
        yield at, low, high


SECTIONS = {
    "SensorModel": "sensor",
    "GroundModel": "ground",
    "ControlModel": "control",
    "SelectionModel": "selection",
    "RolesModel": "roles",
    "SizeModel": "size",
    "AvoidanceModel": "avoidance",
    "AutopilotModel": "autopilot",
    "NetworkModel": "network",
    "GoalModel": "goal",
    "DriveModel": "robots.drive",
    "RobotsModel": "robots",
    "MarkerModel": "marker",
    "UnitModel": "units.0",
    "FlightModel": "units.0.flight",
    "CameraModel": "units.0.camera",
    "DistortionModel": "units.0.camera.distortion",
}
"""Keys of a scenario's parts, by model."""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_at_every_bound_a_mission_is_refused_or_runs():
    """The minimum and the maximum of each key are tried one at a time."""
    ran = 0
    for at, low, high in extremes(load_mission("star")):
        if at[0] != "$defs" or at[1] not in SECTIONS or len(at) > 6:
            continue
        for value in (low, high):
            setting = f"{SECTIONS[at[1]]}.{at[3]}={value}"
            try:
                mission = load_mission("star", ["perception=ideal", "duration_s=0.2", setting])
            except InputError:
                continue
            for _ in run_steps(mission):
                pass
            ran += 1
    assert ran > 100
