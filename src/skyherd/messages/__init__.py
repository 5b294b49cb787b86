"""Every value that passes between the parts: frozen, read-only, checked when made.

Frames: image u right, v down, an integer is a pixel centre, angles run from +u to +v; robot x forward,
y left, angles counter-clockwise. Units are in the names.
"""

from skyherd.messages.commands import FlightCommand, VelocityCommand
from skyherd.messages.detections import Detections, among, centred
from skyherd.messages.goals import MotionGoals, RobotGoal
from skyherd.messages.proximity import Encounters
from skyherd.messages.reports import UnitReport, shared_ids
from skyherd.messages.role_map import RoleMap
from skyherd.messages.tree_status import NOBODY, TreeWord

__all__ = [
    "NOBODY",
    "Detections",
    "Encounters",
    "FlightCommand",
    "MotionGoals",
    "RobotGoal",
    "RoleMap",
    "TreeWord",
    "UnitReport",
    "VelocityCommand",
    "among",
    "centred",
    "shared_ids",
]
