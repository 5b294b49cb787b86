"""Robots keep apart: each limits the speed at which it comes nearer to what it was told of.

With g the gap between two bodies at the time of the image, `age` the time since then and A the time in
which a command takes effect and lasts, a robot comes nearer at no more than

    b = share γ g e^{-γ (age + A)},    γ = 1 / (prompt + A).

If both robots keep to it, then g' >= -γ g, so that g(t) >= g(0) e^{-γ t} > 0 whatever is late or lost:
docs/bodies.md has the proof and its assumptions. Braking distance and delay are in A; the rest of the law
is free. Where the way is barred a robot slides along what bars it (control/steering.py); the bound is kept
last of all.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.control.robot_law import Gains, unicycle_law
from skyherd.control.steering import slide
from skyherd.control.surroundings import Surroundings
from skyherd.geometry import Array, ComplexArray, IntArray, wrap_angle


@dataclass(frozen=True)
class AvoidanceRule:
    """What a robot knows of itself and of how fresh its news is.

    Attributes:
        side_m: side of its marker.
        max_speed_mps: limit of |v|.
        max_turn_radps: limit of |omega|.
        prompt_s: age of news that come as they should: latency and the time between two images.
        step_s: how long a command lasts.
        lag_s: how late the wheels may obey: command delay, and top speed over acceleration.
        overshoot: share by which the wheels may be faster than commanded,
        creep_mps: and by how much besides.
        turn_error_radps: how far its rate of turn may be off.
        axis_offset_m: the body's centre is so far ahead of the wheel axis.
        lifetime_s: news older than this are forgotten.
        steers: whether it looks for a way around; else it only stops.
    """

    side_m: float
    max_speed_mps: float
    max_turn_radps: float
    prompt_s: float
    step_s: float
    lag_s: float = 0.0
    overshoot: float = 0.0
    creep_mps: float = 0.0
    turn_error_radps: float = 0.0
    axis_offset_m: float = 0.0
    lifetime_s: float = 2.0
    steers: bool = True

    @property
    def gamma_ps(self) -> float:
        """γ, 1/s: the rate that allows the fastest approach on news as old as they should be at most."""
        return 1 / (self.prompt_s + self.step_s + self.lag_s)


@dataclass(frozen=True)
class Bounds:
    """Limits on coming nearer, as arrays over pairs.

    Attributes:
        rows: (P,) which robot.
        bearings_rad: (P,) direction of the other in the robot's frame.
        speeds_mps: (P,) b.
        slack_rad: (P,) how far the direction may be off.
    """

    rows: IntArray
    bearings_rad: Array
    speeds_mps: Array
    slack_rad: Array


def closing_bounds(around: Surroundings, rule: AvoidanceRule, time_s: float) -> Bounds:
    """The limits that hold now.

    Two robots that heard of the same image mean the same line between them; news that are late by more than
    they should be may be of an older one, and the line may have turned since by `2 v_max / d` a second.
    """
    pair = around.fresh(time_s)
    age_s = np.maximum(time_s - around.imaged_s[pair], 0.0)
    distances, reaches = around.distances_sides[pair], around.reaches_sides[pair]
    gaps_m = np.maximum(distances - reaches, 0.0) * rule.side_m
    gamma, held_s = rule.gamma_ps, age_s + rule.step_s + rule.lag_s
    allowed = around.shares[pair] * gamma * gaps_m * np.exp(-gamma * held_s)
    late_s = np.maximum(age_s - rule.prompt_s, 0.0)
    return Bounds(
        rows=pair[0],
        bearings_rad=around.bearings_rad(pair),
        speeds_mps=np.maximum(allowed - rule.creep_mps, 0.0) / (1 + rule.overshoot),
        slack_rad=rule.turn_error_radps * held_s
        + 2 * rule.max_speed_mps * late_s / np.maximum(distances * rule.side_m, 1e-9),
    )


def slowed(v_mps: Array, omega_radps: Array, bounds: Bounds, rule: AvoidanceRule) -> tuple[Array, Array]:
    """Speeds within the bounds: the velocity of each body's centre is shortened, and keeps its direction.

    The centre moves at `u = v + i l omega` in the robot's frame, l ahead of the axis; with l = 0 turning
    moves it nowhere, and only v is shortened. While a command lasts the robot turns, so that the other's
    direction sweeps past u; the smallest angle between them counts.
    """
    turning = rule.axis_offset_m * omega_radps
    u = v_mps + 1j * turning
    rows = bounds.rows
    sweep = omega_radps[rows] * rule.step_s
    angle = np.abs(wrap_angle(bounds.bearings_rad - np.angle(u[rows]) - sweep / 2))
    angle -= np.abs(sweep) / 2 + rule.max_turn_radps * rule.lag_s + bounds.slack_rad
    closing = np.abs(u[rows]) * np.cos(np.maximum(angle, 0.0))
    share = np.ones(v_mps.size)
    too_fast = closing > bounds.speeds_mps
    np.minimum.at(share, rows[too_fast], bounds.speeds_mps[too_fast] / closing[too_fast])
    return v_mps * share, omega_radps * share if rule.axis_offset_m else omega_radps


def avoiding_law(
    rho: ComplexArray, gains: Gains, around: Surroundings, rule: AvoidanceRule, time_s: float
) -> tuple[Array, Array]:
    """Speeds v (N,), m/s, and omega (N,), rad/s: the paper's law where nothing bars the way."""
    bounds = closing_bounds(around, rule, time_s)
    if rule.steers:
        speed = gains.speed_mps(np.ones(1))[0]
        wanted = rho * speed
        wanted = wanted * np.minimum(1.0, rule.max_speed_mps / np.maximum(np.abs(wanted), 1e-12))
        barred, way = slide(wanted, bounds.rows, bounds.bearings_rad, bounds.speeds_mps)
        rho = rho.copy()
        rho[barred] = way / speed
    v_mps, omega_radps = unicycle_law(rho, gains)
    v_mps = np.clip(v_mps, -rule.max_speed_mps, rule.max_speed_mps)
    omega_radps = np.clip(omega_radps, -rule.max_turn_radps, rule.max_turn_radps)
    return slowed(v_mps, omega_radps, bounds, rule)
