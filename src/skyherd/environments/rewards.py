"""Rewards of agents, as functions of a transition. They may use the true state.

A reward is one number for all agents, or an array with a number for each. `REWARDS` has the built-in ones.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from skyherd.datasets import Mission
from skyherd.errors import InputError
from skyherd.geometry import Array
from skyherd.loop import Step
from skyherd.messages.checks import shown
from skyherd.sim.robot_teams import make_wheels
from skyherd.text import one_of


@dataclass(frozen=True)
class Transition:
    """One step of an environment.

    Attributes:
        mission: the mission, with wheels, bodies and shape.
        before: state before the action; its `command` is the command that the wheels obeyed.
        after: state after it. `after.metrics` has the shape error and the cost V; `after.fleet` has the
            units. `after.frames` has the images that were taken.
    """

    mission: Mission
    before: Step
    after: Step


RewardFunction = Callable[[Transition], npt.ArrayLike]
"""Function from a transition to a number for all agents, or to an array (A,) in the order of the agents."""

Rewards = str | RewardFunction | Mapping[str | RewardFunction, float]
"""Name of a built-in reward, a function, or weights by name or function."""


def shape_error(transition: Transition) -> float:
    """Return minus the shape error after the step."""
    return -transition.after.metrics.shape.error


def progress(transition: Transition) -> float:
    """Return the decrease of the shape error; the sum over an episode is the total decrease."""
    return transition.before.metrics.shape.error - transition.after.metrics.shape.error


def lyapunov(transition: Transition) -> float:
    """Return minus the cost V, m² (paper, eq. 9), after the step."""
    return -transition.after.metrics.V


def contacts(transition: Transition) -> Array:
    """Return -1 for each robot (N,) whose body overlaps another one or an obstacle after the step."""
    touching = transition.mission.bodies.overlapping(transition.after.positions_m)
    return -np.isin(np.arange(transition.mission.ids.size), touching).astype(float)


def effort(transition: Transition) -> Array:
    """Return minus the mean of (v / v_max)² and (ω / ω_max)² of each robot (N,)."""
    command, wheels = transition.before.command, make_wheels(transition.mission.scenario)
    shares = command.v_mps / wheels.max_speed_mps, command.omega_radps / wheels.max_turn_radps
    return np.asarray(-(shares[0] ** 2 + shares[1] ** 2) / 2)


REWARDS: Mapping[str, RewardFunction] = {
    "shape": shape_error,
    "progress": progress,
    "lyapunov": lyapunov,
    "contacts": contacts,
    "effort": effort,
}
"""Built-in rewards by name."""


class WeightedRewards:
    """Weighted sum of rewards.

    Args:
        rewards: as `Rewards`.

    Raises:
        InputError: a name is unknown, or a weight is not a finite number.
    """

    def __init__(self, rewards: Rewards) -> None:
        weights = rewards if isinstance(rewards, Mapping) else {rewards: 1.0}
        self._terms = [
            (_named(reward), _function(reward), _weight(reward, w)) for reward, w in weights.items()
        ]

    def of(self, transition: Transition, count: int) -> Array:
        """Return the rewards (A,) of `count` agents.

        Raises:
            InputError: a reward is not finite, or is neither one number nor one for each agent.
        """
        total = np.zeros(count)
        for name, function, weight in self._terms:
            values = np.asarray(function(transition), dtype=float)
            if values.shape not in ((), (count,)) or not np.isfinite(values).all():
                what = f"gave {shown(values.tolist())}"
                raise InputError(f"reward {name}", what, f"one finite number, or {count}, one an agent")
            total += weight * values
        return total


def _named(reward: object) -> str:
    return reward if isinstance(reward, str) else getattr(reward, "__name__", shown(reward))


def _function(reward: Any) -> RewardFunction:
    """Return the function of a reward.

    Raises:
        InputError: it is neither a function nor the name of a built-in reward.
    """
    if callable(reward):
        return reward  # type: ignore[no-any-return]
    if isinstance(reward, str) and reward in REWARDS:
        return REWARDS[reward]
    allowed = f"{one_of(str(reward), REWARDS)}, or a function"
    raise InputError("FormationEnv: rewards", shown(reward), allowed)


def _weight(reward: object, weight: object) -> float:
    if not isinstance(weight, int | float | np.number) or not np.isfinite(float(weight)):
        raise InputError(f"FormationEnv: weight of {_named(reward)}", shown(weight), "a finite number")
    return float(weight)
