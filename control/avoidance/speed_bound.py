"""Robots keep apart: each limits the speed at which it comes nearer to what it was told of.

With g the gap between two bodies at the time of the image, `age` the time since then and A the time in
which a command takes effect and lasts, a robot comes nearer at no more than

    b = share γ g e^{-γ (age + A)},    γ = 1 / (prompt + A).

If both robots keep to it, then g' >= -γ g, so that g(t) >= g(0) e^{-γ t} > 0 whatever is late or lost:
docs/bodies.md has the proof and its assumptions. Braking distance and delay are in A; the rest of the law is
free. Where the way is barred a robot slides along what bars it (control/avoidance/detour.py); the bound is
kept last of all.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.control.avoidance.detour import WAYS, Detour
from skyherd.control.avoidance.neighbor_memory import NeighborMemory
from skyherd.control.robots.unicycle import Gains, Wheels, wheel_law
from skyherd.geometry import Array, ComplexArray, IntArray, wrap_angle


@dataclass(frozen=True)
class AvoidanceRule:
    """What a robot knows of itself and of how fresh its news is.

    Attributes:
        side_m: side of its marker.
        wheels: what it can do.
        prompt_s: age that news should have at most: latency and the time between two images,
        next_s: and the age from which on there may be newer ones that others have heard.
        step_s: how long a command lasts.
        lag_s: how late the wheels may obey: command delay, and top speed over acceleration.
        overshoot: share by which the wheels may be faster than commanded,
        creep_mps: and by how much besides.
        turn_error_radps: how far its rate of turn may be off.
        lifetime_s: news older than this are forgotten.
        steering: how it looks for a way around, if at all.
    """

    side_m: float
    wheels: Wheels
    prompt_s: float
    next_s: float
    step_s: float
    lag_s: float = 0.0
    overshoot: float = 0.0
    creep_mps: float = 0.0
    turn_error_radps: float = 0.0
    lifetime_s: float = 2.0
    detour: Detour = "around"

    @property
    def gamma_ps(self) -> float:
        """γ, 1/s: the rate that allows the fastest approach on news as old as they should be at most."""
        return 1 / (self.prompt_s + self.held_s)

    @property
    def held_s(self) -> float:
        """A, s: until a command has passed."""
        return self.step_s + self.lag_s

    def limit_mps(self, share_m: Array, age_s: Array) -> Array:
        """Speeds b for the robot's shares of gaps, m, on news of an age, less what the wheels may add."""
        allowed = self.gamma_ps * share_m * np.exp(-self.gamma_ps * (age_s + self.held_s))
        return np.maximum(allowed - self.creep_mps, 0.0) / (1 + self.overshoot)


@dataclass(frozen=True)
class Bounds:
    """Limits on coming nearer, as arrays over pairs.

    Attributes:
        rows: (P,) which robot.
        bearings_rad: (P,) direction of the other in the robot's frame.
        speeds_mps: (P,) b.
        slack_rad: (P,) how far the direction may be off.
        anyway_mps: (N,) limit in every direction, for what the robot has not been told of.
    """

    rows: IntArray
    bearings_rad: Array
    speeds_mps: Array
    slack_rad: Array
    anyway_mps: Array


def closing_bounds(around: NeighborMemory, rule: AvoidanceRule, time_s: float) -> Bounds:
    """The limits that hold now.

    Two robots that heard of the same image mean the same line between them. One that missed an image means an
    older line, which may have turned since by the angle that `2 v_max age` subtends at their distance. What a
    robot was not told of was beyond the horizon when it was last seen.
    """
    pair = around.fresh(time_s)
    age_s = np.maximum(time_s - around.imaged_s[pair], 0.0)
    distances_m = around.distances_sides[pair] * rule.side_m
    gaps_m = np.maximum(distances_m - around.reaches_sides[pair] * rule.side_m, 0.0)
    strayed_m = np.where(age_s < rule.next_s - 1e-9, 0.0, 2 * rule.wheels.max_speed_mps * age_s)
    turned = np.arcsin(np.minimum(strayed_m / np.maximum(distances_m, 1e-9), 1.0))
    unseen_s = np.maximum(time_s - around.seen_s, 0.0)
    return Bounds(
        rows=pair[0],
        bearings_rad=around.bearings_rad(pair),
        speeds_mps=rule.limit_mps(around.shares[pair] * gaps_m, age_s),
        slack_rad=np.where(strayed_m < distances_m, turned, np.pi)
        + rule.turn_error_radps * (age_s + rule.held_s),
        anyway_mps=rule.limit_mps(around.horizon_sides * rule.side_m / 2, unseen_s),
    )


def slowed(v_mps: Array, omega_radps: Array, bounds: Bounds, rule: AvoidanceRule) -> tuple[Array, Array]:
    """Speeds within the bounds: the velocity of each body's centre is shortened, and keeps its direction.

    The centre moves at `u = v + i l omega` in the robot's frame, l ahead of the axis; with l = 0 turning
    moves it nowhere, and only v is shortened. While a command lasts the robot turns, so that the other's
    direction sweeps past u; the smallest angle between them counts.
    """
    turning = rule.wheels.axis_offset_m * omega_radps
    u = v_mps + 1j * turning
    rows = bounds.rows
    sweep = omega_radps[rows] * rule.step_s
    angle = np.abs(wrap_angle(bounds.bearings_rad - np.angle(u[rows]) - sweep / 2))
    angle -= np.abs(sweep) / 2 + rule.wheels.max_turn_radps * rule.lag_s + bounds.slack_rad
    closing = np.abs(u)[rows] * np.cos(np.maximum(angle, 0.0))
    speed = np.abs(u)
    share = np.minimum(1.0, bounds.anyway_mps / np.where(speed > 0, speed, 1.0))
    too_fast = closing > bounds.speeds_mps
    np.minimum.at(share, rows[too_fast], bounds.speeds_mps[too_fast] / closing[too_fast])
    return v_mps * share, omega_radps * share if rule.wheels.axis_offset_m else omega_radps


def avoiding_law(
    rho: ComplexArray, gains: Gains, around: NeighborMemory, rule: AvoidanceRule, time_s: float
) -> tuple[Array, Array]:
    """Speeds v (N,), m/s, and omega (N,), rad/s: the paper's law where nothing bars the way."""
    bounds = closing_bounds(around, rule, time_s)
    if rule.detour != "none":
        speed = gains.speed_mps(np.ones(1))[0]
        wanted = rho * speed
        wanted = wanted * np.minimum(1.0, rule.wheels.max_speed_mps / np.maximum(np.abs(wanted), 1e-12))
        barred, way = WAYS[rule.detour](wanted, bounds.rows, bounds.bearings_rad, bounds.speeds_mps)
        rho = rho.copy()
        rho[barred] = way / speed
    v_mps, omega_radps = wheel_law(rho, gains, rule.wheels)
    return slowed(v_mps, omega_radps, bounds, rule)
