"""Detections to motion goals to robot commands; nothing here sees truth or calibration."""

from skyherd.control.flight import Follow, Hover, Perimeter
from skyherd.control.free import FreeRule, FreeThenTree
from skyherd.control.fusion import Inboxes
from skyherd.control.goals import motion_goals
from skyherd.control.ground_map import GroundMap
from skyherd.control.rectifier import Rectifier, rectified
from skyherd.control.robot_law import MarkerGains, PixelGains, robot_commands
from skyherd.control.roster import Roster
from skyherd.control.selection import ControlSet, SafetyRadius
from skyherd.control.serve import Serve
from skyherd.control.similarity import Similarity, desired_points, fit_similarity
from skyherd.control.standing import TreeRule
from skyherd.control.template import Template
from skyherd.control.unit import AerialController, Decision, Selection

__all__ = [
    "AerialController",
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
    "Rectifier",
    "Roster",
    "SafetyRadius",
    "Selection",
    "Serve",
    "Similarity",
    "Template",
    "TreeRule",
    "desired_points",
    "fit_similarity",
    "motion_goals",
    "rectified",
    "robot_commands",
]
