"""Steer a team of ground robots into a shape with nothing but what uncalibrated flying cameras see.

`import skyherd` offers what a user of the library needs. Each name is imported from its package when it is
first used, so that the import itself costs nothing. Everything else is in the packages: `skyherd.control`
turns detections into commands, `skyherd.vision` turns images into detections, `skyherd.render` draws images
of a world, and `skyherd.datasets` has scenarios, shapes and labelled image sets.

The library logs under the logger `skyherd`, and is silent unless a handler is added.

Examples:
    >>> import skyherd
    >>> mission = skyherd.load_mission("triangle", {"perception": "ideal", "duration_s": 1.0})
    >>> last = [step for step in skyherd.run_steps(mission)][-1]
    >>> last.time_s
    1.0
"""

import logging
from importlib import import_module
from typing import TYPE_CHECKING

from skyherd.version import __version__

if TYPE_CHECKING:
    from skyherd.control import (
        AerialController,
        Decision,
        GoalInboxes,
        Hover,
        MarkerGains,
        Rectifier,
        SafetyRadius,
        Template,
        robot_commands,
    )
    from skyherd.datasets import (
        Mission,
        load_mission,
        read_dataset,
        scenario_names,
        shape_points,
    )
    from skyherd.errors import InputError, SkyherdError
    from skyherd.inspection import annotate, detect
    from skyherd.loop import Step, run_steps
    from skyherd.messages import Detection, Detections, MotionGoals, UnitReport, VelocityCommand
    from skyherd.recording.reader import read_recording
    from skyherd.runner import run_mission
    from skyherd.vision import create_detector

__all__ = [
    "AerialController",
    "Decision",
    "Detection",
    "Detections",
    "GoalInboxes",
    "Hover",
    "InputError",
    "MarkerGains",
    "Mission",
    "MotionGoals",
    "Rectifier",
    "SafetyRadius",
    "SkyherdError",
    "Step",
    "Template",
    "UnitReport",
    "VelocityCommand",
    "__version__",
    "annotate",
    "create_detector",
    "detect",
    "load_mission",
    "read_dataset",
    "read_recording",
    "robot_commands",
    "run_mission",
    "run_steps",
    "scenario_names",
    "shape_points",
]

_NAMES_BY_MODULE = {
    "skyherd.control": (
        "AerialController",
        "Decision",
        "GoalInboxes",
        "Hover",
        "MarkerGains",
        "Rectifier",
        "SafetyRadius",
        "Template",
        "robot_commands",
    ),
    "skyherd.datasets": ("Mission", "load_mission", "read_dataset", "scenario_names", "shape_points"),
    "skyherd.errors": ("InputError", "SkyherdError"),
    "skyherd.inspection": ("annotate", "detect"),
    "skyherd.loop": ("Step", "run_steps"),
    "skyherd.messages": ("Detection", "Detections", "MotionGoals", "UnitReport", "VelocityCommand"),
    "skyherd.recording.reader": ("read_recording",),
    "skyherd.runner": ("run_mission",),
    "skyherd.vision": ("create_detector",),
}
"""Names imported from each module; a test compares them with the imports above."""

_MODULE_BY_NAME = {name: module for module, names in _NAMES_BY_MODULE.items() for name in names}

logging.getLogger(__name__).addHandler(logging.NullHandler())


def __getattr__(name: str) -> object:
    """Import a public name from its module on first use (PEP 562), and keep it."""
    if name not in _MODULE_BY_NAME:
        raise AttributeError(f"module 'skyherd' has no attribute {name!r}")
    value: object = getattr(import_module(_MODULE_BY_NAME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the module's attributes and all public names, imported or not."""
    return sorted({*globals(), *__all__})
