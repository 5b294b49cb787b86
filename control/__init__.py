"""Control: from detections to motion goals to robot commands.

Nothing in this package sees ground truth or camera calibration.

`AerialController` is the controller of one unit. From the detections of an image it computes motion goals, a
report and a flight command. `GoalFollowers` are the robots: they turn received messages into wheel speeds.
`skyherd.control.policy` defines the interfaces of the exchangeable parts.
"""

from skyherd.control.aerial_controller import AerialController, Decision
from skyherd.control.avoidance.avoiding_law import avoiding_law
from skyherd.control.avoidance.detour import Detour
from skyherd.control.avoidance.neighbor_memory import NeighborMemory
from skyherd.control.avoidance.proximity import BodyRule, proximity
from skyherd.control.avoidance.speed_bound import AvoidanceRule
from skyherd.control.camera_check import CameraRule
from skyherd.control.flight.keep_in_view import KeepInView
from skyherd.control.flight.laws import Follow, Hover, Perimeter
from skyherd.control.formation.assignment import ascend, assign, best_assignment
from skyherd.control.formation.motion import LeadRule, ShapeMotion
from skyherd.control.formation.roles import RoleRule, newest_roles
from skyherd.control.formation.schedule import Schedule
from skyherd.control.formation.similarity import Similarity, desired_points, fit_similarities, fit_similarity
from skyherd.control.formation.size import SizeRule
from skyherd.control.formation.template import Template
from skyherd.control.goals import motion_goals
from skyherd.control.identities import Copies
from skyherd.control.policy import (
    NO_ROBOTS,
    Delivery,
    FlightLaw,
    FlightTask,
    RobotTeam,
    Selection,
    SelectionPolicy,
    TeamOrders,
)
from skyherd.control.rectification.ground_map import GroundMap
from skyherd.control.rectification.rectifier import Rectifier, rectified
from skyherd.control.robot_team import GoalFollowers, RobotClocks
from skyherd.control.robots.goal_fusion import GoalInboxes
from skyherd.control.robots.latency_compensation import LatencyCompensation
from skyherd.control.robots.motion_check import MotionChecks
from skyherd.control.robots.unicycle import (
    MarkerGains,
    PixelGains,
    RobotLaw,
    Wheels,
    robot_commands,
    wheel_law,
)
from skyherd.control.selection.hybrid_selection import HybridSelection
from skyherd.control.selection.safety_radius import SafetyRadius
from skyherd.control.team_clock import TeamClock
from skyherd.control.topology.conditions import (
    Conditions,
    ControlSets,
    check_conditions,
    control_matrix,
    graph_edges,
    owners_by_robot,
)
from skyherd.control.topology.convergence_rate import laplacian, slowest_rate
from skyherd.control.tree.node_state import TreeSettings
from skyherd.control.tree.protocol import TreeProtocol

__all__ = [
    "NO_ROBOTS",
    "AerialController",
    "AvoidanceRule",
    "BodyRule",
    "CameraRule",
    "Conditions",
    "ControlSets",
    "Copies",
    "Decision",
    "Delivery",
    "Detour",
    "FlightLaw",
    "FlightTask",
    "Follow",
    "GoalFollowers",
    "GoalInboxes",
    "GroundMap",
    "Hover",
    "HybridSelection",
    "KeepInView",
    "LatencyCompensation",
    "LeadRule",
    "MarkerGains",
    "MotionChecks",
    "NeighborMemory",
    "Perimeter",
    "PixelGains",
    "Rectifier",
    "RobotClocks",
    "RobotLaw",
    "RobotTeam",
    "RoleRule",
    "SafetyRadius",
    "Schedule",
    "Selection",
    "SelectionPolicy",
    "ShapeMotion",
    "Similarity",
    "SizeRule",
    "TeamClock",
    "TeamOrders",
    "Template",
    "TreeProtocol",
    "TreeSettings",
    "Wheels",
    "ascend",
    "assign",
    "avoiding_law",
    "best_assignment",
    "check_conditions",
    "control_matrix",
    "desired_points",
    "fit_similarities",
    "fit_similarity",
    "graph_edges",
    "laplacian",
    "motion_goals",
    "newest_roles",
    "owners_by_robot",
    "proximity",
    "rectified",
    "robot_commands",
    "slowest_rate",
    "wheel_law",
]
