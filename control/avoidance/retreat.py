"""Retreat: velocities of robots with a body within their margin.

The bound on the approach speed keeps a robot from driving into a body. It does not help against a body that
drives into the robot. A robot therefore leaves a body within its margin at full speed, also from its goal.
docs/bodies.md has the margin that a given speed of the other body requires.
"""

import numpy as np

from skyherd.control.avoidance.detour import DIRECTIONS
from skyherd.control.avoidance.speed_bound import AvoidanceRule, Bounds, safe_shares
from skyherd.geometry import BoolArray, ComplexArray, IntArray, wrap_angle

RETREAT_S = 1.0
"""Time for which a retreat plans, s. Chosen: twice the time of a quarter turn at 3 rad/s. A direction loses
the share of it in which the robot turns; otherwise the best direction could alternate."""


def retreat(bounds: Bounds, rule: AvoidanceRule, driven: BoolArray) -> tuple[IntArray, ComplexArray]:
    """Return the rows (R,), ascending, and velocities (R,), m/s, of robots that leave a body.

    Of `DIRECTIONS` in its frame the robot takes the one with the largest

        s(θ) min_k (-cos(θ - β_k)) (1 - turn(θ) / RETREAT_S)

    over the bodies k within its margin, at bearings β_k. s(θ) is the speed that all bounds allow, and turn(θ)
    the time until one end of the robot points there. The second factor is the speed at which the nearest
    gap opens. Robots are left out if no direction opens all gaps.

    Args:
        bounds: bounds on the approach speeds of N robots.
        rule: the robots' own parameters.
        driven: (N,) robots that may drive, since they have a fresh goal.
    """
    within = bounds.within & driven[bounds.rows]
    rows = np.unique(bounds.rows[within])
    concerned = np.isin(bounds.rows, rows)
    row = np.searchsorted(rows, bounds.rows[concerned])
    theta = np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False)
    off = np.abs(wrap_angle(theta - bounds.bearings_rad[concerned][:, None]))
    speed = np.repeat(np.minimum(rule.wheels.max_speed_mps, bounds.unseen_mps[rows])[:, None], DIRECTIONS, 1)
    share = safe_shares(
        speed[row],
        off - bounds.slack_rad[concerned][:, None],
        bounds.speeds_mps[concerned][:, None],
        rule,
    )
    np.minimum.at(speed, row, speed[row] * share)
    near = within[concerned]
    opening = np.full(speed.shape, np.inf)
    np.minimum.at(opening, row[near], -np.cos(off[near]))
    turn_s = np.minimum(np.abs(theta), np.pi - np.abs(theta)) / rule.wheels.max_turn_radps
    score = speed * opening * np.maximum(1 - turn_s / RETREAT_S, 0.0)
    best = np.arange(rows.size), np.argmax(score, axis=1)
    leaves = score[best] > 0
    return rows[leaves], (np.exp(1j * theta[best[1]]) * rule.wheels.max_speed_mps)[leaves]
