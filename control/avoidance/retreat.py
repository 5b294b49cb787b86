"""Retreat: velocities of robots with a body within their margin.

The bound on the approach speed keeps a robot from driving into a body. It does not help against a body that
drives into the robot. A robot therefore leaves a body within its margin at full speed, also from its goal.
docs/bodies.md has the margin that a given speed of the other body requires.
"""

import numpy as np

from skyherd.control.avoidance.detour import DIRECTIONS
from skyherd.control.avoidance.speed_bound import AvoidanceRule, Bounds, safe_shares
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, wrap_angle

TIMES_S: Array = np.linspace(0.25, 3.0, 12)
"""Times of a planned retreat, s. Chosen: from half a turn at 3 rad/s to the time in which a robot between two
bodies leaves sideways at 0.1 m/s."""

CLEAR_SIDES = 1.0
"""Gap beyond the margin above which a body does not count, marker sides. Chosen: a robot between two bodies
then leaves sideways before it is near the second one."""


def retreat(bounds: Bounds, rule: AvoidanceRule, driven: BoolArray) -> tuple[IntArray, ComplexArray]:
    """Return the rows (R,), ascending, and velocities (R,), m/s, of robots that leave a body.

    Of `DIRECTIONS` in its frame the robot takes the one with the largest mean, over `TIMES_S`, of its
    smallest gap,

        min_k min(|d_k e^{iβ_k} - s(θ) max(t - turn(θ), 0) e^{iθ}| - r_k, CLEAR_SIDES).

    Body k is at the distance d_k and bearing β_k, and its margin begins at the distance r_k. s(θ) is the
    speed that all bounds of a retreat allow, and turn(θ) the time until one end of the robot points there.
    Robots are left out if no direction is better than rest.

    Args:
        bounds: bounds on the approach speeds of N robots.
        rule: the robots' own parameters.
        driven: (N,) robots that may drive, since they have a fresh goal.
    """
    rows = np.unique(bounds.rows[(bounds.gaps_m <= 0) & driven[bounds.rows]])
    of = bounds.take(np.isin(bounds.rows, rows))
    row = np.searchsorted(rows, of.rows)
    theta = np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False)
    speed = np.repeat(np.minimum(rule.wheels.max_speed_mps, of.unseen_mps[rows])[:, None], DIRECTIONS, 1)
    off = np.abs(wrap_angle(theta - of.bearings_rad[:, None])) - of.slack_rad[:, None]
    np.minimum.at(speed, row, speed[row] * safe_shares(speed[row], off, of.retreat_mps[:, None], rule))

    turn_s = np.minimum(np.abs(theta), np.pi - np.abs(theta)) / rule.wheels.max_turn_radps
    way_m = speed[:, :, None] * np.maximum(TIMES_S - turn_s[:, None], 0.0)
    bodies = (of.distances_m * np.exp(1j * of.bearings_rad))[:, None, None]
    distances_m = np.abs(bodies - way_m[row] * np.exp(1j * theta)[:, None])
    least_m = np.full(way_m.shape, CLEAR_SIDES * rule.side_m)
    np.minimum.at(least_m, row, distances_m - (of.distances_m - of.gaps_m)[:, None, None])
    now_m = np.full(rows.size, np.inf)
    np.minimum.at(now_m, row, of.gaps_m)

    mean_m = least_m.mean(axis=2)
    best = np.arange(rows.size), np.argmax(mean_m, axis=1)
    leaves = mean_m[best] > now_m
    return rows[leaves], (np.exp(1j * theta[best[1]]) * rule.wheels.max_speed_mps)[leaves]
