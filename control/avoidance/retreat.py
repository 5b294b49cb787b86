"""Retreat: velocities of robots with a body within their margin.

The bound on the approach speed keeps a robot from driving into a body. It does not help against a body that
drives into the robot. A robot therefore leaves a body within its margin at full speed, also from its goal.
It does not leave the side of an image: that moves with the camera, and bodies beyond it are at rest.
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
    smallest gap. Robots are left out if no direction is better than rest.

    Args:
        bounds: bounds on the approach speeds of N robots.
        rule: the robots' own parameters.
        driven: (N,) robots that may drive, since they have a fresh goal.
    """
    rows = np.unique(bounds.rows[(bounds.gaps_m <= 0) & ~bounds.is_side & driven[bounds.rows]])
    near = bounds.take(np.isin(bounds.rows, rows))
    theta = np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False)
    speeds_mps = _speeds_mps(theta, rows, near, rule)
    bodies = near.take(~near.is_side)
    row = np.searchsorted(rows, bodies.rows)
    mean_m = _mean_gaps_m(theta, speeds_mps, row, bodies, rule)
    now_m = np.full(rows.size, np.inf)
    np.minimum.at(now_m, row, bodies.gaps_m)
    best = np.arange(rows.size), np.argmax(mean_m, axis=1)
    leaves = mean_m[best] > now_m
    return rows[leaves], (np.exp(1j * theta[best[1]]) * rule.wheels.max_speed_mps)[leaves]


def _speeds_mps(theta: Array, rows: IntArray, near: Bounds, rule: AvoidanceRule) -> Array:
    """Return the speeds s(θ) (R, D) that all bounds of a retreat allow, those at image sides included."""
    row = np.searchsorted(rows, near.rows)
    top_mps = np.minimum(rule.wheels.max_speed_mps, near.unseen_mps[rows])
    speeds_mps = np.repeat(top_mps[:, None], theta.size, axis=1)
    off_rad = np.abs(wrap_angle(theta - near.bearings_rad[:, None])) - near.slack_rad[:, None]
    shares = safe_shares(speeds_mps[row], off_rad, near.retreat_mps[:, None], rule)
    np.minimum.at(speeds_mps, row, speeds_mps[row] * shares)
    return speeds_mps


def _mean_gaps_m(
    theta: Array, speeds_mps: Array, row: IntArray, bodies: Bounds, rule: AvoidanceRule
) -> Array:
    """Return the means (R, D), over `TIMES_S`, of the smallest gaps in directions θ (D,).

    The smallest gap at the time t is

        min_k min(|d_k e^{iβ_k} - s(θ) max(t - turn(θ), 0) e^{iθ}| - r_k, CLEAR_SIDES).

    Body k is at the distance d_k and bearing β_k, and its margin begins at the distance r_k. turn(θ) is the
    time until one end of the robot points to θ.
    """
    turn_s = np.minimum(np.abs(theta), np.pi - np.abs(theta)) / rule.wheels.max_turn_radps
    way_m = speeds_mps[:, :, None] * np.maximum(TIMES_S - turn_s[:, None], 0.0)
    places_m = (bodies.distances_m * np.exp(1j * bodies.bearings_rad))[:, None, None]
    distances_m = np.abs(places_m - way_m[row] * np.exp(1j * theta)[:, None])
    gaps_m = np.full(way_m.shape, CLEAR_SIDES * rule.side_m)
    np.minimum.at(gaps_m, row, distances_m - (bodies.distances_m - bodies.gaps_m)[:, None, None])
    return np.asarray(gaps_m.mean(axis=2))
