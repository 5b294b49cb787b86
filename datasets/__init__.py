"""Inputs of runs: formation shapes, scenario files, and labelled image sets.

This package exports the names that the rest of skyherd uses. It has four parts:

- `configuration`: scenario files, checked key by key, and the `Mission` made from a scenario.
- `shapes`: named formation shapes, and words written by robots.
- `generated`: random missions for benchmarks and tests.
- `labelled`: image sets with exact labels: generation, reading and checks.

Names of `generated`, and those of `labelled` that make and check sets, are imported on first access. They
need matplotlib and process pools, which a run does not need.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from skyherd.datasets.configuration.body_models import AvoidanceModel, RolesModel, SizeModel
from skyherd.datasets.configuration.camera_models import CameraFaultModel, CameraModel
from skyherd.datasets.configuration.cameras import CAMERAS
from skyherd.datasets.configuration.fields import DictionaryName, Model, Name, Point
from skyherd.datasets.configuration.file_kinds import (
    LAB,
    STUDY,
    FileKind,
    TomlSource,
    read_source,
    refuse_configuration,
    refuse_other_kind,
    source_text,
)
from skyherd.datasets.configuration.intervention_models import (
    CameraIntervention,
    ControlIntervention,
    CoverIntervention,
    Intervention,
    LifeIntervention,
    NetworkIntervention,
    RobotIntervention,
    TemplateIntervention,
    UnitIntervention,
    read_interventions,
)
from skyherd.datasets.configuration.marker_layout import MAX_PLACES, RobotMarkerModel, make_layout
from skyherd.datasets.configuration.mission import (
    Mission,
    ScenarioSource,
    load_mission,
    make_mission,
    read_scenario,
    scenario_names,
    scenario_text,
)
from skyherd.datasets.configuration.models import (
    METHODS,
    OWN_METHOD,
    AutopilotModel,
    NetworkModel,
    Scenario,
    SelectionModel,
)
from skyherd.datasets.configuration.obstacles import check_obstacle_ids
from skyherd.datasets.configuration.robot_models import (
    DriveModel,
    ObstacleMarkerModel,
    RobotsModel,
    ScatterModel,
    WheelsModel,
)
from skyherd.datasets.configuration.template_models import ShapeModel
from skyherd.datasets.configuration.toml_files import (
    apply_settings,
    built_in_names,
    built_in_text,
    get_value,
    parse_toml,
    put_value,
    read_toml_text,
)
from skyherd.datasets.configuration.toml_writer import toml_text
from skyherd.datasets.configuration.unit_models import FlightModel, UnitModel
from skyherd.datasets.configuration.validation import check_tree, locate
from skyherd.datasets.labelled.ranges import draw_integer, draw_number
from skyherd.datasets.labelled.read import Dataset, LabelledImage, read_dataset
from skyherd.datasets.labelled.spec import DatasetSpec, SpecFile, load_spec, spec_names, spec_text
from skyherd.datasets.shapes.shapes import SHAPES, shape_points
from skyherd.datasets.shapes.strokes import polyline_points

if TYPE_CHECKING:
    from skyherd.datasets.generated.crowded_missions import SHAPE_SPACING, crowded_mission
    from skyherd.datasets.generated.random_missions import (
        BODY_SIDES,
        Crowd,
        random_crowd,
        random_mission,
        star_mission,
    )
    from skyherd.datasets.labelled.check import Verdict, check_dataset
    from skyherd.datasets.labelled.make import make_dataset
    from skyherd.datasets.labelled.preview import draw_preview
else:
    _LOADED_LATER = {
        "BODY_SIDES": "generated.random_missions",
        "Crowd": "generated.random_missions",
        "SHAPE_SPACING": "generated.crowded_missions",
        "Verdict": "labelled.check",
        "check_dataset": "labelled.check",
        "crowded_mission": "generated.crowded_missions",
        "draw_preview": "labelled.preview",
        "make_dataset": "labelled.make",
        "random_crowd": "generated.random_missions",
        "random_mission": "generated.random_missions",
        "star_mission": "generated.random_missions",
    }
    """Modules of the names that are imported on first access."""

    def __getattr__(name: str) -> Any:
        """Import a name of `_LOADED_LATER` on first access (PEP 562)."""
        if name not in _LOADED_LATER:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_LOADED_LATER[name]}"), name)


__all__ = [
    "BODY_SIDES",
    "CAMERAS",
    "LAB",
    "MAX_PLACES",
    "METHODS",
    "OWN_METHOD",
    "SHAPES",
    "SHAPE_SPACING",
    "STUDY",
    "AutopilotModel",
    "AvoidanceModel",
    "CameraFaultModel",
    "CameraIntervention",
    "CameraModel",
    "ControlIntervention",
    "CoverIntervention",
    "Crowd",
    "Dataset",
    "DatasetSpec",
    "DictionaryName",
    "DriveModel",
    "FileKind",
    "FlightModel",
    "Intervention",
    "LabelledImage",
    "LifeIntervention",
    "Mission",
    "Model",
    "Name",
    "NetworkIntervention",
    "NetworkModel",
    "ObstacleMarkerModel",
    "Point",
    "RobotIntervention",
    "RobotMarkerModel",
    "RobotsModel",
    "RolesModel",
    "ScatterModel",
    "Scenario",
    "ScenarioSource",
    "SelectionModel",
    "ShapeModel",
    "SizeModel",
    "SpecFile",
    "TemplateIntervention",
    "TomlSource",
    "UnitIntervention",
    "UnitModel",
    "Verdict",
    "WheelsModel",
    "apply_settings",
    "built_in_names",
    "built_in_text",
    "check_dataset",
    "check_obstacle_ids",
    "check_tree",
    "crowded_mission",
    "draw_integer",
    "draw_number",
    "draw_preview",
    "get_value",
    "load_mission",
    "load_spec",
    "locate",
    "make_dataset",
    "make_layout",
    "make_mission",
    "parse_toml",
    "polyline_points",
    "put_value",
    "random_crowd",
    "random_mission",
    "read_dataset",
    "read_interventions",
    "read_scenario",
    "read_source",
    "read_toml_text",
    "refuse_configuration",
    "refuse_other_kind",
    "scenario_names",
    "scenario_text",
    "shape_points",
    "source_text",
    "spec_names",
    "spec_text",
    "star_mission",
    "toml_text",
]
