"""Robots keep apart: each bounds the speed at which it approaches the bodies that were reported to it.

A unicycle can always stop, so that keeping apart needs a bound on one number only. With g the gap between two
bodies at the time of the image, `age` the time since then, and A the time in which a command takes effect
and lasts, a robot approaches at no more than

    b = share γ g e^{-γ (age + A)},    γ = 1 / (nominal age + A).

If both robots of a pair keep to it, then g' >= -γ g, so that g(t) >= g(0) e^{-γ t} > 0. The bound decays with
the age of the message, which is why no delay and no loss breaks it; docs/bodies.md has the proof and its
assumptions. Braking distance and delay are part of A.

The rest of the law is free. Where the preferred velocity is blocked a robot takes a detour
(`skyherd.control.avoidance.detour`), and the bound is applied last of all.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.control.avoidance.detour import DETOUR_RULES, Detour, out_of_margin
from skyherd.control.avoidance.neighbor_memory import NeighborMemory
from skyherd.control.robots.unicycle import RobotLaw, Wheels, wheel_law
from skyherd.geometry import Array, ComplexArray, IntArray, wrap_angle
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.messages.checks import check_numbers

MIN_DISTANCE_M = 1e-9
"""Distances are divided by at least this, m. Chosen: bodies have radii far above it; it only avoids 0 / 0."""

MIN_SPEED_MPS = 1e-12
"""Speeds are divided by at least this, m/s. Chosen: no robot moves so slowly; it only avoids 0 / 0."""


@dataclass(frozen=True)
class AvoidanceRule:
    """What a robot knows of itself, and of how old the messages that reach it are.

    Attributes:
        side_m: side of its marker.
        wheels: limits of its speeds.
        nominal_age_s: greatest age of a message where none is lost: latency, and time between two images.
        superseded_age_s: age of a message from which on a newer one may exist that other robots received.
        step_s: how long a command lasts.
        lag_s: how late the wheels may obey: delay of commands, and top speed over acceleration.
        overshoot: share by which the wheels may be faster than commanded.
        creep_mps: speed by which they may be faster in addition.
        turn_error_radps: greatest error of its turn rate.
        clock_margin_s: how much older a message may be than the robot's clock tells.
        line_s: time beyond its age for which the line between two bodies may turn. 0 if all robots decide at
            the same instants.
        bearing_error_rad: greatest error of a bearing when its message arrives.
        lifetime_s: age at which messages are forgotten.
        detour: name of the rule by which it finds detours, or `none`.
    """

    side_m: float
    wheels: Wheels
    nominal_age_s: float
    superseded_age_s: float
    step_s: float
    lag_s: float = 0.0
    overshoot: float = 0.0
    creep_mps: float = 0.0
    turn_error_radps: float = 0.0
    clock_margin_s: float = 0.0
    line_s: float = 0.0
    bearing_error_rad: float = 0.0
    lifetime_s: float = 2.0
    detour: Detour = "around"

    def __post_init__(self) -> None:
        check_numbers(
            self,
            positive=("side_m", "step_s", "lifetime_s"),
            not_negative=(
                "nominal_age_s",
                "superseded_age_s",
                "lag_s",
                "overshoot",
                "creep_mps",
                "turn_error_radps",
                "clock_margin_s",
                "line_s",
                "bearing_error_rad",
            ),
        )

    @property
    def gamma_ps(self) -> float:
        """The rate γ, 1/s.

        Of all rates it allows the fastest approach on a message of the nominal age: `γ e^{-γ T}` is largest
        at γ = 1 / T.
        """
        return 1 / (self.nominal_age_s + self.held_s)

    @property
    def held_s(self) -> float:
        """The time A, s, from the command until its last effect: it lasts for a step and acts with a lag."""
        return self.step_s + self.lag_s

    def limit_mps(self, share_m: Array, age_s: Array) -> Array:
        """Commanded speeds (P,), m/s, at which the true approach stays within the bound b.

        Args:
            share_m: (P,) the robot's shares of the gaps, `share g`, m.
            age_s: (P,) ages of the messages.
        """
        allowed = self.gamma_ps * share_m * np.exp(-self.gamma_ps * (age_s + self.held_s))
        return np.maximum(allowed - self.creep_mps, 0.0) / (1 + self.overshoot)


@dataclass(frozen=True)
class Bounds:
    """Bounds on approach speeds, as arrays over P pairs of a robot and another body.

    Attributes:
        rows: (P,) row of the robot.
        bearings_rad: (P,) direction to the other body in the robot's frame.
        speeds_mps: (P,) bounds b on the speed of approach.
        slack_rad: (P,) error that the bearing may have.
        unseen_mps: (N,) bound on each robot's speed in every direction, for bodies that no message named.
    """

    rows: IntArray
    bearings_rad: Array
    speeds_mps: Array
    slack_rad: Array
    unseen_mps: Array


def closing_bounds(memory: NeighborMemory, rule: AvoidanceRule, time_s: Array | float) -> Bounds:
    """The bounds that hold at `time_s`, one time or the robots' (N,).

    Two robots that received messages on the same image use the same line between them. One that
    missed an image uses an older line, which may have turned since by the angle that `2 v_max age` subtends
    at their distance; that angle is part of `slack_rad`. Where robots decide at different instants, the line
    turns for `line_s` longer, until the command's last effect. A body that no message named was beyond the
    horizon when the robot was last seen.
    """
    pair = memory.fresh(time_s)
    time_s = np.broadcast_to(time_s, memory.ids.shape)
    age_s = np.maximum(time_s[pair[0]] - memory.imaged_s[pair], 0.0) + rule.clock_margin_s
    distances_m = memory.distances_sides[pair] * rule.side_m
    gaps_m = distances_m - memory.reaches_sides[pair] * rule.side_m  # below 0 the limit is 0
    is_newest = age_s < rule.superseded_age_s - TIME_TOLERANCE_S
    strayed_m = np.where(is_newest, 0.0, 2 * rule.wheels.max_speed_mps * (age_s + rule.line_s))
    turned = np.arcsin(np.minimum(strayed_m / np.maximum(distances_m, MIN_DISTANCE_M), 1.0))
    unseen_s = np.maximum(time_s - memory.seen_s, 0.0) + rule.clock_margin_s
    return Bounds(
        rows=pair[0],
        bearings_rad=memory.bearings_rad(pair, time_s),
        speeds_mps=rule.limit_mps(memory.shares[pair] * gaps_m, age_s),
        slack_rad=np.where(strayed_m < distances_m, turned, np.pi)
        + rule.turn_error_radps * (age_s + rule.held_s)
        + rule.bearing_error_rad,
        unseen_mps=rule.limit_mps(memory.horizon_sides * rule.side_m / 2, unseen_s),
    )


def slowed(v_mps: Array, omega_radps: Array, *, bounds: Bounds, rule: AvoidanceRule) -> tuple[Array, Array]:
    """Speeds v (N,), m/s, and ω (N,), rad/s, reduced until they keep to the bounds.

    The centre of a body moves at `u = v + i l ω` in the robot's frame, where it lies ahead of the axis by l.
    u is shortened and keeps its direction; with l = 0 turning moves the centre nowhere, and only v is
    shortened. While a command lasts the robot turns, and the direction to the other body sweeps past u: the
    smallest angle between the two counts, less the slack of the bearing.
    """
    u = v_mps + 1j * (rule.wheels.axis_offset_m * omega_radps)
    rows = bounds.rows
    sweep = omega_radps[rows] * rule.step_s
    angle = np.abs(wrap_angle(bounds.bearings_rad - np.angle(u[rows]) - sweep / 2))
    angle -= np.abs(sweep) / 2 + rule.wheels.max_turn_radps * rule.lag_s + bounds.slack_rad
    closing = np.abs(u)[rows] * np.cos(np.maximum(angle, 0.0))
    speed = np.abs(u)
    share = np.minimum(1.0, bounds.unseen_mps / np.where(speed > 0, speed, 1.0))
    too_fast = closing > bounds.speeds_mps
    np.minimum.at(share, rows[too_fast], bounds.speeds_mps[too_fast] / closing[too_fast])
    return v_mps * share, omega_radps * share if rule.wheels.axis_offset_m else omega_radps


def avoiding_law(
    rho: ComplexArray, law: RobotLaw, *, memory: NeighborMemory, rule: AvoidanceRule, time_s: Array | float
) -> tuple[Array, Array]:
    """Speeds v (N,), m/s, and ω (N,), rad/s, that keep robots apart.

    Where nothing blocks a robot it is `wheel_law` to the bit. A robot that has a body within its margin may
    not approach it at all, and drives away from it first.

    Args:
        rho: (N,) vectors to follow in the robots' frames, in the unit of the law.
        law: how fast a vector is followed.
        memory: bodies near the robots.
        rule: what the robots know of themselves.
        time_s: now, or the robots' times (N,) where each has its own.
    """
    bounds = closing_bounds(memory, rule, time_s)
    if rule.detour != "none":
        gain = law.speed_mps(np.ones(1))[0]
        preferred = rho * gain
        speed = np.maximum(np.abs(preferred), MIN_SPEED_MPS)
        preferred = preferred * np.minimum(1.0, rule.wheels.max_speed_mps / speed)
        blocked, velocities = DETOUR_RULES[rule.detour](
            preferred, rows=bounds.rows, bearings_rad=bounds.bearings_rad, speeds_mps=bounds.speeds_mps
        )
        rho = rho.copy()
        rho[blocked] = velocities / gain
        within = (bounds.speeds_mps <= 0) & (np.abs(preferred[bounds.rows]) > MIN_SPEED_MPS)
        leaving, velocities = out_of_margin(
            preferred,
            rows=bounds.rows[within],
            bearings_rad=bounds.bearings_rad[within],
            spreads_rad=bounds.slack_rad[within] + rule.wheels.max_turn_radps * rule.lag_s,
        )
        rho[leaving] = velocities / gain
    v_mps, omega_radps = wheel_law(rho, law, rule.wheels)
    return slowed(v_mps, omega_radps, bounds=bounds, rule=rule)
