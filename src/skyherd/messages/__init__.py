"""Messages between the parts of the system: immutable, and validated at construction.

Frames: image u right, v down, an integer is a pixel centre, angles run from +u to +v; robot x forward, y
left, angles counter-clockwise. Units are in the names.
"""

from skyherd.messages.commands import FlightCommand, VelocityCommand
from skyherd.messages.detections import Detection, Detections, Quality, centred
from skyherd.messages.goals import MotionGoals, RobotGoal
from skyherd.messages.ids import ANONYMOUS_ID, BORDER_IDS, NO_ID, among, find_rows, rows_of
from skyherd.messages.proximity import Proximity
from skyherd.messages.reports import UnitReport, shared_ids
from skyherd.messages.role_map import RoleMap
from skyherd.messages.sighting import Sighting
from skyherd.messages.times import TIME_TOLERANCE_S
from skyherd.messages.tree_status import NO_SLOT, TreeStatus

__all__ = [
    "ANONYMOUS_ID",
    "BORDER_IDS",
    "NO_ID",
    "NO_SLOT",
    "TIME_TOLERANCE_S",
    "Detection",
    "Detections",
    "FlightCommand",
    "MotionGoals",
    "Proximity",
    "Quality",
    "RobotGoal",
    "RoleMap",
    "Sighting",
    "TreeStatus",
    "UnitReport",
    "VelocityCommand",
    "among",
    "centred",
    "find_rows",
    "rows_of",
    "shared_ids",
]
