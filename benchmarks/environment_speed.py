"""Measure steps a second of `FormationEnv`, beside VMAS if it is installed.

```sh
export OPENBLAS_NUM_THREADS=1
python benchmarks/environment_speed.py
```

Each environment is stepped with random actions on one core, alone and without vectorization. Processor time
counts. VMAS has no cameras; its row is the scenario `simple_spread` with as many agents.
"""

import argparse
import json
import time
from collections.abc import Callable
from importlib.util import find_spec

from skyherd.environments import FormationEnv

SCENARIO = "star"
AGENTS = 16
"""Robots of the scenario."""


def rate(step: Callable[[], object], seconds: float) -> float:
    """Return steps a second of processor time."""
    start, count = time.process_time(), 0
    while time.process_time() - start < seconds:
        step()
        count += 1
    return count / (time.process_time() - start)


def skyherd_rate(observations: str, perception: str, seconds: float) -> float:
    """Return the rate of `FormationEnv`; an ended episode begins again."""
    env = FormationEnv(SCENARIO, {"perception": perception}, observations=observations)

    def step() -> None:
        if not env.agents:
            env.reset(seed=1)
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})

    return rate(step, seconds)


def vmas_rate(seconds: float) -> float:
    """Return the rate of one world of VMAS."""
    import torch
    from vmas import make_env

    torch.set_num_threads(1)
    env = make_env("simple_spread", num_envs=1, device="cpu", seed=1, n_agents=AGENTS)
    env.reset()
    return rate(lambda: env.step([env.get_random_action(agent) for agent in env.agents]), seconds)


def main() -> None:
    """Print the rates."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="processor time of each row, s")
    options = parser.parse_args()
    rates = {
        f"skyherd, {observations}, {perception}": skyherd_rate(observations, perception, options.seconds)
        for observations, perception in (
            ("vectors", "noisy"),
            ("detections", "noisy"),
            ("vectors", "rendered"),
            ("images", "rendered"),
        )
    }
    if find_spec("vmas") is None:
        print("vmas is not installed: pip install vmas")
    else:
        rates[f"VMAS, simple_spread, {AGENTS} agents"] = vmas_rate(options.seconds)
    print(json.dumps({name: round(value, 1) for name, value in rates.items()}, indent=1))


if __name__ == "__main__":
    main()
