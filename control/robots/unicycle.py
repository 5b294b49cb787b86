"""The robots' control law (paper, eq. 7-8), in the paper's pixels or in marker units.

With the paper's gains the camera scale multiplies v but not ω. A robot's arcs, and so the final size of the
shape, then depend on the cameras. With goals in marker sides the scale cancels. Trajectories are then the
same under every camera, zoom and height (`MarkerGains`).
"""

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from skyherd.control.robots.goal_fusion import GoalInboxes, fuse_marker_sides, fuse_pixels
from skyherd.errors import InputError
from skyherd.geometry import Array, ComplexArray, IntArray, wrap_angle
from skyherd.messages import VelocityCommand
from skyherd.messages.checks import check_kind, check_numbers, shown


class RobotLaw(Protocol):
    """Interface of a robot's law: it fuses the received goals into a vector and sets the speed along it.

    `PixelGains` and `MarkerGains` implement it. A further implementation is a frozen dataclass with the four
    members below. It needs no base class and has no state, since `GoalInboxes` is the robots' memory. The
    functions of this module turn vector and speed into (v, ω), within the limits of the wheels. For robots
    with bodies, `skyherd.control.avoidance.speed_bound` may reduce the speeds afterwards.

    A law may choose the unit of length of the vector. Vector and speed must be consistent: a robot that faces
    along its vector drives at `speed_mps(|vector|)`. The paper's stability proof requires the vector to be a
    positive multiple of the sum of the units' ground vectors (eq. 5).

    Attributes:
        k_omega: turn rate per radian of heading error, 1/s.
        needs_distances: whether units must send image distances to neighbours, and inboxes must store them.
    """

    @property
    def k_omega(self) -> float:
        """Turn rate per radian of heading error, 1/s; positive."""
        ...

    @property
    def needs_distances(self) -> bool:
        """True if the law uses image distances to neighbours; otherwise the inboxes need not store them."""
        ...

    def follow(self, inboxes: GoalInboxes, time_s: float) -> ComplexArray:
        """Return the vectors (N,) that the robots must follow, each in its own frame, `forward + i left`.

        A robot stops, with exactly 0, without a fresh goal (`GoalInboxes.fresh`) or within the law's
        threshold of its goal. Each robot may use only its own column of the inboxes.
        """
        ...

    def speed_mps(self, rho: Array) -> Array:
        """Return speeds (any shape), m/s, for lengths `rho` in the unit of `follow`; linear and odd.

        It is also called with components of a vector, which may be negative, and with 1 to obtain the gain.
        """
        ...


@dataclass(frozen=True)
class PixelGains:
    """Law of the paper: `v = k_v ρ`, with ρ = ρ_i^g in pixels (eq. 4 and 8).

    The unknown mean scale of the cameras acts as a gain on v (the paper's Remark 1).

    Attributes:
        k_v: speed per pixel of goal, m/s/px.
        k_omega: turn rate per radian, 1/s.
        b_th: stop threshold, px (the paper's Corollary 2).
    """

    k_v: float
    k_omega: float
    b_th: float
    needs_distances: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_numbers(self, positive=("k_v", "k_omega"), not_negative=("b_th",))

    def follow(self, inboxes: GoalInboxes, time_s: float) -> ComplexArray:
        """Return the vectors ρ_i^g (N,), px (eq. 4); 0 below the threshold."""
        return _above(fuse_pixels(inboxes, time_s), self.b_th)

    def speed_mps(self, rho: Array) -> Array:
        """Return speeds `k_v rho` for lengths in pixels."""
        return self.k_v * rho


@dataclass(frozen=True)
class MarkerGains:
    """Law in marker units: `v = k side_m Σ_j ρ_j / side_j`, with ρ_j and side_j in unit j's pixels.

    The robot knows the side of its own marker in metres, so that v is k times a ground vector. Pixels cancel:
    speed and direction are the same under every camera.

    Attributes:
        k: speed per metre of goal, 1/s.
        k_omega: turn rate per radian, 1/s.
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
        """Return the vectors Σ_j ρ_j / side_j (N,), marker sides; 0 below the threshold."""
        return _above(fuse_marker_sides(inboxes, time_s), self.b_th)

    def speed_mps(self, rho: Array) -> Array:
        """Return speeds `k side_m rho` for lengths in marker sides."""
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
"""Wheels of the paper's robots, which are points without speed limits."""


def _above(rho: ComplexArray, threshold: float) -> ComplexArray:
    """Return the vectors (N,) with those shorter than the threshold set to 0."""
    return np.where(np.abs(rho) >= threshold, rho, 0)


def unicycle_law(rho: ComplexArray, law: RobotLaw) -> tuple[Array, Array]:
    """Return speeds v (N,), m/s, and ω (N,), rad/s, for vectors ρ (N,) in robot frames (paper, eq. 7-8).

    With `α = π - arg ρ` in [-π, π), and α = 0 for ρ = 0,

        v = -sign(cos α) k |ρ|,   ω = k_ω (α_d - α),

    where α_d = 0 if |α| <= π/2 (the goal is behind, and the robot drives backwards), else π. As -cos α has
    the sign of ρ's forward part, a goal exactly to one side gives v = 0, and the robot turns in place.
    """
    length = np.abs(rho)
    alpha = np.where(length > 0, wrap_angle(np.pi - np.angle(rho)), 0.0)
    # cos α = -Re ρ / |ρ|, so that -sign(cos α) = sign(Re ρ).
    v_mps = np.sign(rho.real) * law.speed_mps(length)
    return v_mps, law.k_omega * wrap_angle(np.where(rho.real <= 0, 0.0, np.pi) - alpha)


def offset_law(rho: ComplexArray, law: RobotLaw, wheels: Wheels) -> tuple[Array, Array]:
    """Return speeds v (N,), m/s, and ω (N,), rad/s, of robots with the marker ahead of the wheel axis by l.

    The centre of such a marker can move in any direction at once. It is driven straight to its goal:

        v = k ρ_forward,   ω = k ρ_left / l.

    If a limit would be exceeded, both are reduced by one factor, which keeps the direction.
    """
    v_mps, omega_radps = law.speed_mps(rho.real), law.speed_mps(rho.imag) / wheels.axis_offset_m
    excess = np.maximum(np.abs(v_mps) / wheels.max_speed_mps, np.abs(omega_radps) / wheels.max_turn_radps)
    slower = np.maximum(excess, 1.0)
    return v_mps / slower, omega_radps / slower


def wheel_law(rho: ComplexArray, law: RobotLaw, wheels: Wheels) -> tuple[Array, Array]:
    """Return speeds v (N,), m/s, and ω (N,), rad/s, within the wheels' limits, for vectors in robot frames.

    The law is `offset_law` if the marker lies off the wheel axis. Otherwise it is `unicycle_law`, with v and
    ω clipped.
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
    """Return the commands of all robots without bodies at `time_s`, each from its own inbox alone.

    A robot without a fresh goal, or at its goal, stops.
    """
    check_kind("robot_commands: inboxes", inboxes, GoalInboxes, "GoalInboxes")
    if not callable(getattr(law, "follow", None)):
        raise InputError("robot_commands: law", shown(law), "a RobotLaw, such as MarkerGains")
    return finite_command(inboxes.ids, *wheel_law(law.follow(inboxes, time_s), law, wheels))


def finite_command(ids: IntArray, v_mps: Array, omega_radps: Array) -> VelocityCommand:
    """Return the command of robots (N,), with zero for those whose speed or turn rate is not finite."""
    finite = np.isfinite(v_mps) & np.isfinite(omega_radps)
    return VelocityCommand(ids, np.where(finite, v_mps, 0.0), np.where(finite, omega_radps, 0.0))
