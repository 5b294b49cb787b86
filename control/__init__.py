"""Detections to motion goals to robot commands; nothing here sees truth or calibration."""

from skyherd.control.aerial_controller import AerialController, Decision, Selection
from skyherd.control.avoidance.neighbor_memory import NeighborMemory
from skyherd.control.avoidance.proximity import BodyRule
from skyherd.control.avoidance.speed_bound import AvoidanceRule
from skyherd.control.flight.keep_in_view import KeepInView
from skyherd.control.flight.laws import Follow, Hover, Perimeter
from skyherd.control.formation.roles import RoleRule, newest_roles
from skyherd.control.formation.schedule import Schedule
from skyherd.control.formation.similarity import Similarity, desired_points, fit_similarities, fit_similarity
from skyherd.control.formation.size import SizeRule
from skyherd.control.formation.template import Template
from skyherd.control.goals import motion_goals
from skyherd.control.hybrid_selection import HybridRule, HybridSelection
from skyherd.control.rectification.ground_map import GroundMap
from skyherd.control.rectification.rectifier import Rectifier, rectified
from skyherd.control.robot_team import Team
from skyherd.control.robots.goal_fusion import GoalInboxes
from skyherd.control.robots.unicycle import MarkerGains, PixelGains, Wheels, robot_commands
from skyherd.control.topology.safety_radius import ControlSet, SafetyRadius
from skyherd.control.tree.node_state import TreeRule
from skyherd.control.tree.protocol import TreeProtocol

__all__ = [
    "AerialController",
    "AvoidanceRule",
    "BodyRule",
    "ControlSet",
    "Decision",
    "Follow",
    "GoalInboxes",
    "GroundMap",
    "Hover",
    "HybridRule",
    "HybridSelection",
    "KeepInView",
    "MarkerGains",
    "NeighborMemory",
    "Perimeter",
    "PixelGains",
    "Rectifier",
    "RoleRule",
    "SafetyRadius",
    "Schedule",
    "Selection",
    "Similarity",
    "SizeRule",
    "Team",
    "Template",
    "TreeProtocol",
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
