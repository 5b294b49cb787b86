"""Formation shapes and scenarios."""

from skyherd.datasets.models import Scenario
from skyherd.datasets.scenario import Mission, load_mission, make_mission, scenario_names, scenario_text
from skyherd.datasets.shapes import SHAPES, shape_points

__all__ = [
    "SHAPES",
    "Mission",
    "Scenario",
    "load_mission",
    "make_mission",
    "scenario_names",
    "scenario_text",
    "shape_points",
]
