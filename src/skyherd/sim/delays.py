"""Message delays of a scenario, from the image to the use of a message, in whole steps of the world.

A message arrives its sender's latency after the image. Robots use it at the next step of the world. Units use
it with their first image after that step.
"""

import numpy as np

from skyherd.datasets import Scenario

ROUNDING_STEPS = 1e-9
"""Tolerance of a delay above whole steps, in steps. Derived: above the rounding of a quotient."""


def whole_steps(delay_s: float, step_s: float) -> float:
    """Return a delay rounded up to whole time steps, s."""
    return float(np.ceil(delay_s / step_s - ROUNDING_STEPS) * step_s)


def min_message_delay_s(scenario: Scenario) -> float:
    """Return the minimum time from an image to the robots' use of a message about it, s."""
    return whole_steps(min(unit.latency_s for unit in scenario.units), scenario.step_s)


def max_message_delay_s(scenario: Scenario) -> float:
    """Return the maximum time from an image to the robots' use of a message about it, s."""
    slowest_s = max(unit.latency_s for unit in scenario.units)
    return whole_steps(slowest_s + scenario.network.delay_s, scenario.step_s)


def min_report_delay_s(scenario: Scenario) -> float:
    """Return the minimum time, s, from an image to another unit's image that uses the report about it.

    If all units take their images at the same steps, it is a whole number of images.
    """
    taken_in_s = min_message_delay_s(scenario) + scenario.step_s
    rates_hz = {unit.frame_rate_hz for unit in scenario.units}
    if len(rates_hz) > 1:
        return taken_in_s
    apart = 1 / (rates_hz.pop() * scenario.step_s)  # steps between two images
    if abs(apart - round(apart)) > ROUNDING_STEPS * apart:
        return max(taken_in_s, float(np.floor(apart)) * scenario.step_s)
    return whole_steps(taken_in_s, max(round(apart), 1) * scenario.step_s)
