"""Environments for reinforcement learning, with the interface of PettingZoo; extra `rl`.

`FormationEnv` runs a scenario. Agents are its robots or its aerial units. Observations come from images and
messages alone. Rewards, `state()` and `infos` may use the true state.
"""

from importlib.util import find_spec

from skyherd.errors import InputError

if find_spec("pettingzoo") is None:
    raise InputError("skyherd.environments", "pettingzoo is not installed", "pip install 'skyherd[rl]'")

from skyherd.environments.formation_env import FormationEnv
from skyherd.environments.rewards import REWARDS, RewardFunction, Transition

__all__ = ["REWARDS", "FormationEnv", "RewardFunction", "Transition"]
