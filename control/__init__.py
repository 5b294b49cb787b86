"""Detections to motion goals to robot commands; nothing here sees truth or calibration."""

from skyherd.control.avoidance import AvoidanceRule
from skyherd.control.encounters import BodyRule
from skyherd.control.flight import Follow, Hover, Perimeter
from skyherd.control.free import FreeRule, FreeThenTree
from skyherd.control.fusion import Inboxes
from skyherd.control.goals import motion_goals
from skyherd.control.ground_map import GroundMap
from skyherd.control.program import Program
from skyherd.control.rectifier import Rectifier, rectified
from skyherd.control.robot_law import MarkerGains, PixelGains, Wheels, robot_commands
from skyherd.control.roles import RoleRule, newest_roles
from skyherd.control.roster import Roster
from skyherd.control.selection import ControlSet, SafetyRadius
from skyherd.control.serve import Serve
from skyherd.control.similarity import Similarity, desired_points, fit_similarities, fit_similarity
from skyherd.control.size import SizeRule
from skyherd.control.standing import TreeRule
from skyherd.control.surroundings import Surroundings
from skyherd.control.team import Team
from skyherd.control.template import Template
from skyherd.control.unit import AerialController, Decision, Selection

__all__ = [
    "AerialController",
    "AvoidanceRule",
    "BodyRule",
    "ControlSet",
    "Decision",
    "Follow",
    "FreeRule",
    "FreeThenTree",
    "GroundMap",
    "Hover",
    "Inboxes",
    "MarkerGains",
    "Perimeter",
    "PixelGains",
    "Program",
    "Rectifier",
    "RoleRule",
    "Roster",
    "SafetyRadius",
    "Selection",
    "Serve",
    "Similarity",
    "SizeRule",
    "Surroundings",
    "Team",
    "Template",
    "TreeRule",
    "Wheels",
    "desired_points",
    "fit_similarities",
    "fit_similarity",
    "motion_goals",
    "newest_roles",
    "rectified",
    "robot_commands",
]
