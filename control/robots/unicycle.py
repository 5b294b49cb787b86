"""The robots' control law (paper, eq. 7-8), in the paper's pixels or in marker units.

With the paper's gains the scale of the cameras multiplies v but not ω, so that a robot's arcs, and with them
the final size of the shape, depend on the cameras. With goals in marker sides the scale cancels, and whole
trajectories are the same under every camera, zoom and height (`MarkerGains`).
"""

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from skyherd.control.robots.goal_fusion import GoalInboxes, fuse_marker_sides, fuse_pixels
from skyherd.errors import InputError
from skyherd.geometry import Array, ComplexArray, wrap_angle
from skyherd.messages import VelocityCommand
from skyherd.messages.checks import check_kind, check_numbers, shown


class RobotLaw(Protocol):
    """How a robot combines the goals that it received into one vector, and how fast it follows that vector.

    `PixelGains` and `MarkerGains` are the two that there are. A third one is a frozen dataclass with the four
    members below; it needs no base class and keeps no state, since the robots' memory is `GoalInboxes`. The
    functions of this module turn the vector and the speed into (v, ω), within the limits of the wheels; where
    robots have bodies, `skyherd.control.avoidance.speed_bound` may slow them down after that.

    The unit of length of the vector is the law's own choice. The one duty is that vector and speed fit
    together: a robot that faces along its vector drives at `speed_mps(|vector|)`, and for the paper's proof
    of stability the vector is a positive multiple of the sum of the units' ground vectors (eq. 5).

    Attributes:
        k_omega: turn rate for an error of heading of one radian, 1/s.
        needs_distances: whether units must send image distances to neighbours, and the inboxes keep them.
    """

    @property
    def k_omega(self) -> float:
        """Turn rate for an error of heading of one radian, 1/s; positive."""
        ...

    @property
    def needs_distances(self) -> bool:
        """Whether the law uses image distances to neighbours; if not, the inboxes need not keep them."""
        ...

    def follow(self, inboxes: GoalInboxes, time_s: float) -> ComplexArray:
        """The vectors (N,) that the robots are to follow, each in its own frame, `forward + i left`.

        A robot without a fresh goal (`GoalInboxes.fresh`), or nearer to its goal than the law's threshold,
        gets exactly 0, and stands still. Each robot may use its own column of the inboxes only.
        """
        ...

    def speed_mps(self, rho: Array) -> Array:
        """Speeds (any shape), m/s, for lengths `rho` in the unit of `follow`; linear, and odd for negatives.

        It is also called with components of a vector, which may be negative, and with 1 to learn the gain.
        """
        ...


@dataclass(frozen=True)
class PixelGains:
    """The paper's law: `v = k_v ρ`, with ρ = ρ_i^g in pixels (eq. 4 and 8).

    The unknown mean scale of the cameras acts as a gain on v (the paper's Remark 1).

    Attributes:
        k_v: speed for a pixel of goal, m/s/px.
        k_omega: turn rate for a radian, 1/s.
        b_th: stop threshold, px (the paper's Corollary 2).
    """

    k_v: float
    k_omega: float
    b_th: float
    needs_distances: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_numbers(self, positive=("k_v", "k_omega"), not_negative=("b_th",))

    def follow(self, inboxes: GoalInboxes, time_s: float) -> ComplexArray:
        """The vectors ρ_i^g (N,), px (eq. 4); 0 below the threshold."""
        return _above(fuse_pixels(inboxes, time_s), self.b_th)

    def speed_mps(self, rho: Array) -> Array:
        """Speeds `k_v rho` for lengths in pixels."""
        return self.k_v * rho


@dataclass(frozen=True)
class MarkerGains:
    """The law in marker units: `v = k side_m Σ_j ρ_j / side_j`, with ρ_j and side_j in unit j's pixels.

    The robot knows the side of its own marker in metres, so that v is k times a ground vector. Pixels cancel:
    speed as well as direction is the same under every camera.

    Attributes:
        k: speed for a metre of goal, 1/s.
        k_omega: turn rate for a radian, 1/s.
        b_th: stop threshold, marker sides.
        side_m: side of the robot's marker.
    """

    k: float
    k_omega: float
    b_th: float
    side_m: float
    needs_distances: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_numbers(self, positive=("k", "k_omega", "side_m"), not_negative=("b_th",))

    def follow(self, inboxes: GoalInboxes, time_s: float) -> ComplexArray:
        """The vectors Σ_j ρ_j / side_j (N,), marker sides; 0 below the threshold."""
        return _above(fuse_marker_sides(inboxes, time_s), self.b_th)

    def speed_mps(self, rho: Array) -> Array:
        """Speeds `k side_m rho` for lengths in marker sides."""
        return self.k * self.side_m * rho


@dataclass(frozen=True)
class Wheels:
    """Limits and geometry of a robot's differential drive, as the robot knows them.

    Attributes:
        max_speed_mps: limit of |v|.
        max_turn_radps: limit of |ω|.
        axis_offset_m: distance by which the marker's centre lies ahead of the wheel axis.
    """

    max_speed_mps: float
    max_turn_radps: float
    axis_offset_m: float = 0.0

    def __post_init__(self) -> None:
        check_numbers(
            self,
            positive=("max_speed_mps", "max_turn_radps"),
            finite=("axis_offset_m",),
            endless=("max_speed_mps", "max_turn_radps"),
        )


UNLIMITED = Wheels(np.inf, np.inf)
"""Wheels of the paper's robots, which are points without limits of speed."""


def _above(rho: ComplexArray, threshold: float) -> ComplexArray:
    """Vectors (N,), those shorter than the threshold set to 0."""
    return np.where(np.abs(rho) >= threshold, rho, 0)


def unicycle_law(rho: ComplexArray, law: RobotLaw) -> tuple[Array, Array]:
    """Speeds v (N,), m/s, and ω (N,), rad/s, for vectors ρ (N,) in the robots' frames (paper, eq. 7-8).

    With `α = π - arg ρ` in [-π, π), and α = 0 for ρ = 0,

        v = -sign(cos α) k |ρ|,   ω = k_ω (α_d - α),

    where α_d = 0 if |α| <= π/2 (the goal is behind, and the robot drives backwards), else π. As -cos α has
    the sign of ρ's forward part, a goal exactly to one side gives v = 0, and the robot turns in place.
    """
    length = np.abs(rho)
    alpha = np.where(length > 0, wrap_angle(np.pi - np.angle(rho)), 0.0)
    v_mps = np.sign(rho.real) * law.speed_mps(length)
    return v_mps, law.k_omega * wrap_angle(np.where(rho.real <= 0, 0.0, np.pi) - alpha)


def offset_law(rho: ComplexArray, law: RobotLaw, wheels: Wheels) -> tuple[Array, Array]:
    """Speeds v (N,), m/s, and ω (N,), rad/s, of robots whose markers lie ahead of the wheel axis by l.

    The centre of such a marker can move in any direction at once, and is driven straight to its goal:

        v = k ρ_forward,   ω = k ρ_left / l.

    Where a limit would be exceeded both are reduced by one factor, which keeps the direction.
    """
    v_mps, omega_radps = law.speed_mps(rho.real), law.speed_mps(rho.imag) / wheels.axis_offset_m
    excess = np.maximum(np.abs(v_mps) / wheels.max_speed_mps, np.abs(omega_radps) / wheels.max_turn_radps)
    slower = np.maximum(excess, 1.0)
    return v_mps / slower, omega_radps / slower


def wheel_law(rho: ComplexArray, law: RobotLaw, wheels: Wheels) -> tuple[Array, Array]:
    """Speeds v (N,), m/s, and ω (N,), rad/s, within the wheels' limits, for vectors in the robots' frames.

    It is `offset_law` where the marker lies off the wheel axis, and else `unicycle_law`, v and ω clipped.
    """
    check_kind("wheel_law: wheels", wheels, Wheels, "Wheels")
    if wheels.axis_offset_m:
        return offset_law(rho, law, wheels)
    v_mps, omega_radps = unicycle_law(rho, law)
    return (
        np.clip(v_mps, -wheels.max_speed_mps, wheels.max_speed_mps),
        np.clip(omega_radps, -wheels.max_turn_radps, wheels.max_turn_radps),
    )


def robot_commands(
    inboxes: GoalInboxes, law: RobotLaw, time_s: float, *, wheels: Wheels = UNLIMITED
) -> VelocityCommand:
    """Commands of all robots at `time_s`, each from its own inbox alone; robots without bodies.

    A robot without a fresh goal, or at its goal, stands still.
    """
    check_kind("robot_commands: inboxes", inboxes, GoalInboxes, "GoalInboxes")
    if not callable(getattr(law, "follow", None)):
        raise InputError("robot_commands: law", shown(law), "a RobotLaw, such as MarkerGains")
    v_mps, omega_radps = wheel_law(law.follow(inboxes, time_s), law, wheels)
    return VelocityCommand(inboxes.ids, v_mps, omega_radps)
