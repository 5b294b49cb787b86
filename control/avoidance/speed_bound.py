"""Collision avoidance: each robot bounds its approach speed towards reported bodies.

A unicycle can always stop, so a bound on one number is sufficient. Let g be the gap between two bodies at the
time of the image and `age` the time since. Let A be the time in which a command takes effect and lasts. A
robot approaches at no more than

    b = share γ g e^{-γ (age + A)},    γ = 1 / (nominal age + A).

If both robots of a pair satisfy it, then g' >= -γ g, so that g(t) >= g(0) e^{-γ t} > 0. The bound decays with
the age of the message. It therefore holds under any delay and any message loss; docs/bodies.md has the proof
and its assumptions. Braking distance and actuation delay are part of A.

The remaining law is free (`skyherd.control.avoidance.avoiding_law`). The bound is applied last.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from skyherd.control.avoidance.detour import Detour
from skyherd.control.avoidance.neighbor_memory import NeighborMemory
from skyherd.control.robots.unicycle import Wheels
from skyherd.geometry import Array, BoolArray, IntArray, wrap_angle
from skyherd.messages import ANONYMOUS_ID, BORDER_IDS, TIME_TOLERANCE_S, among
from skyherd.messages.checks import check_numbers

MIN_DISTANCE_M = 1e-9
"""Minimum divisor for distances, m. Chosen: far below the radius of any body; it only avoids 0 / 0."""

HALVINGS = 8
"""Number of bisections for the largest safe speed. Chosen: it is then too small by 0.4 % at most."""


@dataclass(frozen=True)
class AvoidanceRule:
    """A robot's own parameters, and the ages of the messages that it receives.

    Attributes:
        side_m: side of its marker.
        wheels: limits of its speeds.
        nominal_age_s: maximum age of a message without message loss: latency plus image period.
        superseded_age_s: message age from which other robots may hold a newer message.
        step_s: duration of a command.
        lag_s: maximum actuation lag: command delay, plus top speed over acceleration.
        brakes_s: the part of `lag_s` that is top speed over acceleration; 0 if unknown.
        overshoot: relative speed error of the wheels.
        creep_mps: absolute speed error of the wheels.
        turn_error_radps: maximum error of the turn rate.
        clock_margin_s: maximum underestimate of a message's age by the robot's clock.
        line_s: time beyond a message's age for which the line between two bodies may turn. 0 if all robots
            decide at the same instants.
        bearing_error_rad: maximum error of a bearing when its message arrives.
        lifetime_s: age at which messages are stale.
        detour: name of the detour rule, or `none`.
        retreat_sides: part of the margin that a robot may use up while it leaves a body, marker sides.
    """

    side_m: float
    wheels: Wheels
    nominal_age_s: float
    superseded_age_s: float
    step_s: float
    lag_s: float = 0.0
    brakes_s: float = 0.0
    overshoot: float = 0.0
    creep_mps: float = 0.0
    turn_error_radps: float = 0.0
    clock_margin_s: float = 0.0
    line_s: float = 0.0
    bearing_error_rad: float = 0.0
    lifetime_s: float = 2.0
    detour: Detour = "around"
    retreat_sides: float = 0.0

    def __post_init__(self) -> None:
        check_numbers(
            self,
            positive=("side_m", "step_s", "lifetime_s"),
            not_negative=(
                "nominal_age_s",
                "superseded_age_s",
                "lag_s",
                "brakes_s",
                "overshoot",
                "creep_mps",
                "turn_error_radps",
                "clock_margin_s",
                "line_s",
                "bearing_error_rad",
                "retreat_sides",
            ),
        )

    @property
    def gamma_ps(self) -> float:
        """The rate γ, 1/s.

        It allows the fastest approach for a message of the nominal age T: `γ e^{-γ T}` is largest at γ = 1 /
        T.
        """
        return 1 / (self.nominal_age_s + self.held_s)

    @property
    def held_s(self) -> float:
        """The time A, s, from a command to its last effect: its duration plus the actuation lag."""
        return self.step_s + self.lag_s

    def lag_at_s(self, speeds_mps: Array) -> Array:
        """Return the actuation lags, s, from speeds up to the top speed: lower ones brake in less time."""
        return np.asarray(self.lag_s - self.brakes_s * (1 - speeds_mps / self.wheels.max_speed_mps))

    def limit_mps(self, share_m: Array, age_s: Array) -> Array:
        """Return commanded speeds (P,), m/s, at which the true approach stays within the bound b.

        Args:
            share_m: (P,) the robot's shares of the gaps, `share g`, m.
            age_s: (P,) ages of the messages.
        """
        allowed = self.gamma_ps * share_m * np.exp(-self.gamma_ps * (age_s + self.held_s))
        # The true speed is at most (1 + overshoot) v + creep.
        return np.maximum(allowed - self.creep_mps, 0.0) / (1 + self.overshoot)


@dataclass(frozen=True)
class Bounds:
    """Bounds on approach speeds, as arrays over P pairs of a robot and another body.

    Attributes:
        rows: (P,) row of the robot.
        bearings_rad: (P,) direction to the other body in the robot's frame.
        speeds_mps: (P,) bounds b on the approach speed.
        slack_rad: (P,) maximum error of the bearing.
        gaps_m: (P,) gaps beyond the margin in the image; negative within it.
        distances_m: (P,) distances between the centres in the image.
        retreat_mps: (P,) bounds b of a robot that leaves a body within its margin.
        is_side: (P,) sides of an image, which moves with its camera; bodies may stand beyond them.
        unseen_mps: (N,) bound on each robot's speed in every direction, for bodies without a message.
    """

    rows: IntArray
    bearings_rad: Array
    speeds_mps: Array
    slack_rad: Array
    gaps_m: Array
    distances_m: Array
    retreat_mps: Array
    is_side: BoolArray
    unseen_mps: Array

    def take(self, pairs: BoolArray) -> "Bounds":
        """Return the bounds of the pairs in a mask (P,)."""
        names = [field.name for field in fields(self) if field.name != "unseen_mps"]
        return replace(self, **{name: getattr(self, name)[pairs] for name in names})

    def of_retreat(self, leaving: IntArray) -> "Bounds":
        """Return the bounds with those of a retreat for the robots in rows (R,)."""
        speeds_mps = np.where(np.isin(self.rows, leaving), self.retreat_mps, self.speeds_mps)
        return replace(self, speeds_mps=speeds_mps)


def closing_bounds(memory: NeighborMemory, rule: AvoidanceRule, time_s: Array | float) -> Bounds:
    """Return the bounds at `time_s`, one time or the robots' times (N,).

    Two robots with messages about the same image use the same line between them. A robot that missed an image
    uses an older line. That line may have turned by the angle that `2 v_max age` subtends at their distance,
    which is part of `slack_rad`. A body without a message was beyond the horizon when the robot was last
    seen. Where robots decide at different instants, the line turns for `line_s` longer, until the last effect
    of the command.
    """
    pair = memory.fresh(time_s)
    time_s = np.broadcast_to(time_s, memory.ids.shape)
    age_s = np.maximum(time_s[pair[0]] - memory.imaged_s[pair], 0.0) + rule.clock_margin_s
    distances_m = memory.distances_sides[pair] * rule.side_m
    gaps_m = _gaps_sides(memory, pair) * rule.side_m  # below 0 the limit is 0
    lent_m = rule.retreat_sides * rule.side_m
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
        gaps_m=gaps_m,
        distances_m=distances_m,
        retreat_mps=rule.limit_mps(memory.shares[pair] * (gaps_m + lent_m), age_s),
        is_side=among(memory.other_ids[pair[1]], BORDER_IDS),
        unseen_mps=rule.limit_mps(memory.horizon_sides * rule.side_m / 2, unseen_s),
    )


def _gaps_sides(memory: NeighborMemory, pair: tuple[IntArray, IntArray]) -> Array:
    """Return the gaps (P,) beyond the margin in the images, marker sides.

    A robot makes way for others, unless a body that is no robot of the team is within its own margin. A unit
    that does not see this body may ask it to.
    """
    row, column = pair
    gaps_sides = memory.distances_sides[pair] - memory.reaches_sides[pair]
    ids = memory.other_ids[column]
    is_foreign = (ids == ANONYMOUS_ID) | ((ids >= 0) & (memory.shares[pair] == 1))
    leaves = np.isin(row, row[is_foreign & (gaps_sides <= 0)])
    return np.asarray(gaps_sides - np.where(leaves, 0.0, memory.ways_sides[pair]))


def approach_speeds(speeds_mps: Array, angles_rad: Array, rule: AvoidanceRule) -> Array:
    """Return the maximum approach speeds, m/s, of robots that drive at angles to other bodies.

    The robot may turn towards the body before its speed has decayed.

    Args:
        speeds_mps: speeds, from 0.
        angles_rad: smallest angles between the velocity and the direction to the body, less all errors.
        rule: the robots' own parameters.
    """
    turned_rad = rule.wheels.max_turn_radps * rule.lag_at_s(speeds_mps)
    return np.asarray(speeds_mps * np.cos(np.maximum(angles_rad - turned_rad, 0.0)))


def safe_shares(speeds_mps: Array, angles_rad: Array, limits_mps: Array, rule: AvoidanceRule) -> Array:
    """Return the shares of the speeds at which the approach speeds are within their limits.

    The approach speed increases with the speed. The share that is safe at the lag of the unreduced speed is
    therefore safe, and bisection finds a larger one.

    Args:
        speeds_mps: speeds, from 0.
        angles_rad: as in `approach_speeds`.
        limits_mps: limits of the approach speeds.
        rule: the robots' own parameters.
    """
    approach = approach_speeds(speeds_mps, angles_rad, rule)
    too_fast = approach > limits_mps
    safe = np.ones(approach.shape)
    np.divide(np.broadcast_to(limits_mps, approach.shape), approach, out=safe, where=too_fast)
    if rule.brakes_s and too_fast.any():
        high = np.ones(approach.shape)
        for _ in range(HALVINGS):
            middle = (safe + high) / 2
            is_safe = approach_speeds(middle * speeds_mps, angles_rad, rule) <= limits_mps
            safe, high = np.where(is_safe, middle, safe), np.where(is_safe, high, middle)
    return safe


def slowed(v_mps: Array, omega_radps: Array, *, bounds: Bounds, rule: AvoidanceRule) -> tuple[Array, Array]:
    """Return speeds v (N,), m/s, and ω (N,), rad/s, reduced to satisfy the bounds.

    The centre of a body moves at `u = v + i l ω` in the robot's frame, where it lies ahead of the axis by l.
    The magnitude of u is reduced and its direction kept. With l = 0 the turn rate does not move the centre,
    and only v is reduced. During a command the robot turns, and the direction to the other body sweeps past
    u. The smallest angle between the two counts, minus the bearing error.
    """
    u = v_mps + 1j * (rule.wheels.axis_offset_m * omega_radps)
    rows = bounds.rows
    sweep = omega_radps[rows] * rule.step_s
    angle = np.abs(wrap_angle(bounds.bearings_rad - np.angle(u[rows]) - sweep / 2))
    angle -= np.abs(sweep) / 2 + bounds.slack_rad
    speed = np.abs(u)
    share = np.minimum(1.0, bounds.unseen_mps / np.where(speed > 0, speed, 1.0))
    np.minimum.at(share, rows, safe_shares(speed[rows], angle, bounds.speeds_mps, rule))
    return v_mps * share, omega_radps * share if rule.wheels.axis_offset_m else omega_radps
