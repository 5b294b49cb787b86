"""Formation shapes, scenarios, and labelled image sets."""

from skyherd.datasets.configuration.mission import (
    Mission,
    load_mission,
    make_mission,
    scenario_names,
    scenario_text,
)
from skyherd.datasets.configuration.models import Scenario
from skyherd.datasets.labelled.read import Dataset, LabelledImage, read_dataset
from skyherd.datasets.shapes.shapes import SHAPES, shape_points

__all__ = [
    "SHAPES",
    "Dataset",
    "LabelledImage",
    "Mission",
    "Scenario",
    "load_mission",
    "make_mission",
    "read_dataset",
    "scenario_names",
    "scenario_text",
    "shape_points",
]
