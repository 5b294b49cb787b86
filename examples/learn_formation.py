"""Improve a small policy by an evolution strategy, and compare it with the built-in law.

    python examples/learn_formation.py --generations 20 --starts 5

Each robot runs the same policy of seven numbers on its own goal and the bodies near it. It begins as the
paper's law with gains only. The tasks are those of `skyherd study methods`.
"""

import argparse
from collections.abc import Callable, Iterable

import numpy as np

from skyherd.environments import FormationEnv, Transition
from skyherd.study.spec import load_study

STUDY = load_study("methods").spec
TASKS = {task.name: task.set for task in STUDY.tasks}
OURS = {**STUDY.set, **STUDY.sweeps[0].set}
START = np.array([np.log(0.8), np.log(0.8), -4.0, 0.0, 0.0, -4.0, 0.0])
"""Logarithms of the gains of v and ω, as in the study; then nearly no repulsion and no caution."""


def act(theta: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the actions (A, 2) of all robots from their observations (A, 5 + 3 bodies)."""
    gain, turn, repulsion, reach = np.exp(theta[:4])
    caution, range_ = 1 / (1 + np.exp(-theta[5])), np.exp(theta[6])
    goal, bodies = seen[:, 0] + 1j * seen[:, 1], seen[:, 5:].reshape(len(seen), -1, 3)
    gaps, towards = bodies[..., 0], bodies[..., 1] + 1j * bodies[..., 2]
    push = -(np.exp(-gaps / reach) * towards).sum(axis=1)
    wanted = seen[:, 2] * (gain * goal + repulsion * (1 + 1j * theta[4]) * push)
    wanted /= np.maximum(np.abs(wanted), 1.0)
    sign = np.where(wanted.real < 0, -1.0, 1.0)
    ahead = (sign[:, None] * towards.conj()).real.clip(0.0)
    slower = (1 - caution * ahead * np.exp(-gaps.clip(0.0) / range_)).prod(axis=1)
    return np.column_stack([sign * np.abs(wanted) * slower, turn * np.angle(wanted * sign)]).clip(-1, 1)


def log_error(transition: Transition) -> float:
    """Return minus the shape error in decades above 0.1 %, a reward of our own."""
    return -float(np.log10(max(transition.after.metrics.shape.error, 1e-3) / 1e-3))


def make_env(task: str, duration_s: float, law: dict[str, object] | None = None) -> FormationEnv:
    """Return the environment of a task; `law` replaces settings of the built-in law."""
    settings = {**OURS, **TASKS[task], "duration_s": duration_s, **(law or {})}
    return FormationEnv(
        STUDY.scenario, settings, bodies=6, rewards={log_error: 1.0, "contacts": 30.0}, keep_steps=True
    )


Policy = Callable[[dict[str, np.ndarray], dict[str, dict]], dict[str, np.ndarray]]


def learned(theta: np.ndarray) -> Policy:
    """Return the policy of parameters for `episode`."""

    def policy(observations: dict, infos: dict) -> dict[str, np.ndarray]:
        return dict(zip(observations, act(theta, np.stack(list(observations.values()))), strict=True))

    return policy


def built_in(observations: dict, infos: dict) -> dict[str, np.ndarray]:
    """Return the actions of the built-in law."""
    return {agent: info["reference_action"] for agent, info in infos.items()}


def episode(env: FormationEnv, seed: int, policy: Policy) -> float:
    """Return the mean reward per robot and step of an episode."""
    observations, infos = env.reset(seed=seed)
    rewards = []
    while env.agents:
        observations, reward, _, _, infos = env.step(policy(observations, infos))
        rewards.append(np.mean(list(reward.values())))
    return float(np.mean(rewards))


def evolve(
    score: Callable[[np.ndarray, int], float], mean: np.ndarray, generations: int, seed: int
) -> Iterable[np.ndarray]:
    """Yield the mean of a CMA evolution strategy after each generation (Hansen 2016, without restarts)."""
    rng, n, step = np.random.default_rng(seed), mean.size, 0.5
    size = 4 + int(3 * np.log(n))
    weights = np.log(size / 2 + 0.5) - np.log(np.arange(1, size // 2 + 1))
    weights /= weights.sum()
    mu = 1 / (weights**2).sum()
    c_s, c_c = (mu + 2) / (n + mu + 5), 4 / (n + 4)
    c_1 = 2 / ((n + 1.3) ** 2 + mu)
    c_mu = min(1 - c_1, 2 * (mu - 2 + 1 / mu) / ((n + 2) ** 2 + mu))
    usual = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
    covariance, path_s, path_c = np.eye(n), np.zeros(n), np.zeros(n)
    for generation in range(generations):
        scales, axes = np.linalg.eigh(covariance)
        root = axes * np.sqrt(scales)
        drawn = rng.standard_normal((size, n))
        scores = [score(mean + step * root @ z, generation) for z in drawn]
        best = drawn[np.argsort(scores)[::-1][: weights.size]]
        moved = root @ (weights @ best)
        mean = mean + step * moved
        path_s = (1 - c_s) * path_s + np.sqrt(c_s * (2 - c_s) * mu) * (axes @ (weights @ best))
        path_c = (1 - c_c) * path_c + np.sqrt(c_c * (2 - c_c) * mu) * moved
        ranks = np.einsum("k,ki,kj->ij", weights, best @ root.T, best @ root.T)
        covariance = (1 - c_1 - c_mu) * covariance + c_1 * np.outer(path_c, path_c) + c_mu * ranks
        step *= np.exp(c_s / (1 + c_s) * (np.linalg.norm(path_s) / usual - 1))
        yield mean


def train(generations: int, seed: int) -> np.ndarray:
    """Return the parameters after some generations, each on one start of two tasks."""
    envs = {name: make_env(name, 25.0) for name in TASKS}

    def score(theta: np.ndarray, generation: int) -> float:
        names = [list(TASKS)[(2 * generation + part) % len(TASKS)] for part in range(2)]
        return float(np.mean([episode(envs[name], 1000 + generation, learned(theta)) for name in names]))

    theta = START
    for generation, theta in enumerate(evolve(score, START, generations, seed)):
        print(f"generation {generation}: score {score(theta, generation):.2f}", flush=True)
    return theta


def compare(policies: dict[str, tuple[Policy, dict[str, object]]], starts: int) -> None:
    """Print, for each task, how many starts formed the shape and how many collided, by policy."""
    print(f"| task, {starts} starts | " + " | ".join(policies) + " |")
    print("|---" * (1 + len(policies)) + "|")
    for task in TASKS:
        cells = []
        for policy, law in policies.values():
            env = make_env(task, 40.0, law)
            runs = []
            for seed in range(1, starts + 1):
                episode(env, seed, policy)
                runs.append(env.summary())
            formed = [run for run in runs if run["converged"]]
            time_s = np.median([run["reached_s"] for run in formed]) if formed else np.nan
            collided = sum(run["collisions"] > 0 for run in runs)
            cells.append(f"{len(formed)} formed, {collided} collided, {time_s:.1f} s")
        print(f"| {task} | " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    """Train, and compare with the law before training and with the built-in law."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--generations", type=int, default=20)
    parser.add_argument("--starts", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    theta = train(options.generations, options.seed)
    print("parameters:", theta.round(3).tolist())
    compare(
        {
            "paper's law": (built_in, {"avoidance.on": False}),
            "before": (learned(START), {}),
            "learned": (learned(theta), {}),
            "skyherd": (built_in, {}),
        },
        options.starts,
    )


if __name__ == "__main__":
    main()
