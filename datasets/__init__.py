"""Formation shapes, scenarios, and labelled image sets."""

from skyherd.datasets.models import Scenario
from skyherd.datasets.read import Dataset, LabelledImage, read_dataset
from skyherd.datasets.scenario import Mission, load_mission, make_mission, scenario_names, scenario_text
from skyherd.datasets.shapes import SHAPES, shape_points

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
