"""Every value that passes between the parts: frozen, read-only, checked when made.

Frames: image u right, v down, an integer is a pixel centre, angles run from +u to +v; robot x forward,
y left, angles counter-clockwise. Units are in the names.
"""

from skyherd.messages.commands import FlightCommand, VelocityCommand
from skyherd.messages.detections import Detections, among, centred
from skyherd.messages.goals import MotionGoals, RobotGoal
from skyherd.messages.proximity import Proximity
from skyherd.messages.reports import UnitReport, shared_ids
from skyherd.messages.role_map import RoleMap
from skyherd.messages.tree_status import NO_ID, TreeStatus

__all__ = [
    "NO_ID",
    "Detections",
    "FlightCommand",
    "MotionGoals",
    "Proximity",
    "RobotGoal",
    "RoleMap",
    "TreeStatus",
    "UnitReport",
    "VelocityCommand",
    "among",
    "centred",
    "shared_ids",
]
