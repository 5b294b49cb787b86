"""The robots' law (paper, eq. 7-8), in the paper's pixels or in marker units."""

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from skyherd.control.robots.goal_fusion import GoalInboxes, fuse_marker_sides, fuse_pixels
from skyherd.geometry import Array, ComplexArray, wrap_angle
from skyherd.messages import VelocityCommand


class Gains(Protocol):
    """How a robot turns the goals it heard into a vector to follow, and that into speed."""

    @property
    def k_omega(self) -> float:
        """Turn rate a radian, 1/s."""
        ...

    @property
    def needs_distances(self) -> bool:
        """Whether robots need the image distances to their neighbours."""
        ...

    def follow(self, inboxes: GoalInboxes, time_s: float) -> ComplexArray:
        """The vector to follow (N,), zero below the stop threshold."""
        ...

    def speed_mps(self, rho: Array) -> Array:
        """Forward speed for a vector of length `rho`."""
        ...


@dataclass(frozen=True)
class PixelGains:
    """The paper's gains: `v = k_v rho`, rho in pixels; the camera's scale acts as a gain on v.

    Attributes:
        k_v: m/s per px.
        k_omega: 1/s.
        b_th: stop threshold, px.
    """

    k_v: float
    k_omega: float
    b_th: float
    needs_distances: ClassVar[bool] = True

    def follow(self, inboxes: GoalInboxes, time_s: float) -> ComplexArray:
        """rho_i^g (N,), px (eq. 4), zero below b_th."""
        return _above(fuse_pixels(inboxes, time_s), self.b_th)

    def speed_mps(self, rho: Array) -> Array:
        """K_v rho."""
        return self.k_v * rho


@dataclass(frozen=True)
class MarkerGains:
    """Marker-unit gains: `v = k rho`, with `rho = side_m Σ_j rho_j / side_px_j` in metres.

    The robot knows its own marker's side; pixels cancel, so that speed as well as direction is the same
    under every camera, zoom and height.

    Attributes:
        k: 1/s.
        k_omega: 1/s.
        b_th: stop threshold, marker sides.
        side_m: side of the robot's marker.
    """

    k: float
    k_omega: float
    b_th: float
    side_m: float
    needs_distances: ClassVar[bool] = False

    def follow(self, inboxes: GoalInboxes, time_s: float) -> ComplexArray:
        """Σ_j rho_j / side_px_j (N,), marker sides, zero below b_th."""
        return _above(fuse_marker_sides(inboxes, time_s), self.b_th)

    def speed_mps(self, rho: Array) -> Array:
        """K side_m rho."""
        return self.k * self.side_m * rho


@dataclass(frozen=True)
class Wheels:
    """What a robot can do.

    Attributes:
        max_speed_mps: limit of |v|.
        max_turn_radps: limit of |omega|.
        axis_offset_m: its marker's centre is so far ahead of the wheel axis.
    """

    max_speed_mps: float
    max_turn_radps: float
    axis_offset_m: float = 0.0


UNLIMITED = Wheels(np.inf, np.inf)
"""The paper's point robots."""


def _above(rho: ComplexArray, threshold: float) -> ComplexArray:
    return np.where(np.abs(rho) >= threshold, rho, 0)


def unicycle_law(rho: ComplexArray, gains: Gains) -> tuple[Array, Array]:
    """Speeds v (N,), m/s, and omega (N,), rad/s, for vectors (N,) in the robots' frames (eq. 7-8).

    With `alpha = pi - arg rho` in [-pi, pi), and alpha = 0 for rho = 0,

        v = -sign(cos alpha) k rho,   omega = k_omega (alpha_d - alpha),

    alpha_d = 0 where |alpha| <= pi/2 (the goal is behind: drive backwards), else pi. As `-cos alpha` has
    the sign of rho's forward part, a goal exactly abeam gives v = 0: the robot turns in place.
    """
    length = np.abs(rho)
    alpha = np.where(length > 0, wrap_angle(np.pi - np.angle(rho)), 0.0)
    v_mps = np.sign(rho.real) * gains.speed_mps(length)
    return v_mps, gains.k_omega * wrap_angle(np.where(rho.real <= 0, 0.0, np.pi) - alpha)


def offset_law(rho: ComplexArray, gains: Gains, wheels: Wheels) -> tuple[Array, Array]:
    """Speeds of robots whose markers lie ahead of the wheel axis, by l: then a centre can move any way.

        v = k rho_forward,   omega = k rho_left / l,

    so that the centre moves straight to the goal; slower, but no other way, where a limit would be passed.
    """
    v_mps, omega_radps = gains.speed_mps(rho.real), gains.speed_mps(rho.imag) / wheels.axis_offset_m
    excess = np.maximum(np.abs(v_mps) / wheels.max_speed_mps, np.abs(omega_radps) / wheels.max_turn_radps)
    slower = np.maximum(excess, 1.0)
    return v_mps / slower, omega_radps / slower


def wheel_law(rho: ComplexArray, gains: Gains, wheels: Wheels) -> tuple[Array, Array]:
    """Speeds v (N,), m/s, and omega (N,), rad/s, within the limits, for vectors in the robots' frames."""
    if wheels.axis_offset_m:
        return offset_law(rho, gains, wheels)
    v_mps, omega_radps = unicycle_law(rho, gains)
    return (
        np.clip(v_mps, -wheels.max_speed_mps, wheels.max_speed_mps),
        np.clip(omega_radps, -wheels.max_turn_radps, wheels.max_turn_radps),
    )


def robot_commands(
    inboxes: GoalInboxes, gains: Gains, time_s: float, wheels: Wheels = UNLIMITED
) -> VelocityCommand:
    """What all robots do now, each from its own inbox; one that hears nothing, or is there, holds still."""
    v_mps, omega_radps = wheel_law(gains.follow(inboxes, time_s), gains, wheels)
    return VelocityCommand(inboxes.ids, v_mps, omega_radps)
