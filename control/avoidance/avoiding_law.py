"""Law of robots that avoid bodies: follow the goal, take detours, retreat, and bound the approach speed."""

import numpy as np

from skyherd.control.avoidance.detour import DETOUR_RULES
from skyherd.control.avoidance.neighbor_memory import NeighborMemory
from skyherd.control.avoidance.retreat import retreat
from skyherd.control.avoidance.speed_bound import AvoidanceRule, closing_bounds, slowed
from skyherd.control.robots.unicycle import RobotLaw, wheel_law
from skyherd.geometry import Array, BoolArray, ComplexArray
from skyherd.messages.checks import check_kind, check_vectors

MIN_SPEED_MPS = 1e-12
"""Minimum divisor for speeds, m/s. Chosen: far below the speed of any robot; it only avoids 0 / 0."""


def avoiding_law(
    rho: ComplexArray,
    law: RobotLaw,
    *,
    memory: NeighborMemory,
    rule: AvoidanceRule,
    time_s: Array | float,
    driven: BoolArray | None = None,
) -> tuple[Array, Array]:
    """Return collision-free speeds v (N,), m/s, and ω (N,), rad/s.

    An unblocked robot follows `wheel_law` exactly. A robot with a body within its margin leaves it at full
    speed, whatever its goal.

    Args:
        rho: (N,) vectors to follow in the robots' frames, in the unit of the law.
        law: speed law of the robots.
        memory: bodies near the robots.
        rule: the robots' own parameters.
        time_s: present time, or the robots' own times (N,).
        driven: (N,) robots with a fresh goal; the others may not retreat. All if None.
    """
    check_vectors("avoiding_law", rho=rho)
    check_kind("avoiding_law: memory", memory, NeighborMemory, "a memory of neighbours")
    check_kind("avoiding_law: rule", rule, AvoidanceRule, "a rule of avoidance")
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
        leaving, velocities = retreat(bounds, rule, np.ones(rho.size, bool) if driven is None else driven)
        rho[leaving] = velocities / gain
        bounds = bounds.of_retreat(leaving)
    v_mps, omega_radps = wheel_law(rho, law, rule.wheels)
    return slowed(v_mps, omega_radps, bounds=bounds, rule=rule)
