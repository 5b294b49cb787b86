"""Measure the throughput of a study on one worker process and on several, through the same cluster code.

    python benchmarks/study.py                   # 1 and 2 workers, 3 rounds
    python benchmarks/study.py --workers 8 --rounds 5 --runs 64

Each round makes the same runs with one worker and with all, one after the other, on warm workers. It prints
the ratio of each round, and their median. For comparison, the same runs are made in bare processes, one and
as many, without a scheduler. Shared caches and memory, and other load, reduce the throughput: n processes
that compete with m others for too few cores get n (1 + m) / (n + m) times the throughput of one. The
processor time of client and scheduler is printed, too.
"""

import argparse
import os
from collections.abc import Sequence
from multiprocessing import get_context
from multiprocessing.pool import Pool
from statistics import median
from time import perf_counter, process_time

from distributed import Client

from skyherd.datasets import Mission, load_mission
from skyherd.study.cluster import open_client, run_missions
from skyherd.study.measure import measure


def make_missions(count: int, perception: str) -> list[Mission]:
    """Return runs of equal length, each with its own seed."""
    settings = [f"perception={perception}", "duration_s=4.0"]
    return [load_mission("triangle", settings, seed=seed) for seed in range(count)]


def runs_per_s(client: Client, missions: list[Mission], name: str) -> float:
    """Return the throughput of one batch of missions, from the first submission to the last result, /s."""
    started_s = perf_counter()
    named = ((f"{name}-{number}", mission) for number, mission in enumerate(missions))
    made = sum(len(outcomes) for outcomes in run_missions(client, named, []))
    return made / (perf_counter() - started_s)


def _run(mission: Mission) -> None:
    measure("", mission, [])


def bare_runs_per_s(pool: Pool, missions: Sequence[Mission]) -> float:
    """Return the throughput of bare processes that take one run after the other, /s."""
    started_s = perf_counter()
    pool.map(_run, missions, chunksize=1)
    return len(missions) / (perf_counter() - started_s)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--perception", default="rendered")
    options = parser.parse_args()
    missions = make_missions(options.runs, options.perception)
    ratios, bounds = [], []
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # as the cluster's workers have it
    bare = get_context("spawn")
    with (
        open_client(jobs=1) as one,
        open_client(jobs=options.workers) as all_workers,
        bare.Pool(1) as one_bare,
        bare.Pool(options.workers) as all_bare,
    ):
        warm = missions[: 2 * options.workers]
        for client in (one, all_workers):
            runs_per_s(client, warm, "warm")
        for pool in (one_bare, all_bare):
            bare_runs_per_s(pool, warm)
        for number in range(options.rounds):
            began_s = process_time()
            slow = runs_per_s(one, missions, f"one-{number}")
            fast = runs_per_s(all_workers, missions, f"all-{number}")
            ratios.append(fast / slow)
            own_ms = 1e3 * (process_time() - began_s) / (2 * len(missions))
            bounds.append(bare_runs_per_s(all_bare, missions) / bare_runs_per_s(one_bare, missions))
            told = f"{slow:.2f} runs/s on 1, {fast:.2f} on all: {ratios[-1]:.2f} x, bare {bounds[-1]:.2f} x"
            print(f"round {number + 1}: {told}; client and scheduler {own_ms:.0f} ms a run", flush=True)
    told = f"{median(ratios):.2f} x on {options.workers} workers, {median(bounds):.2f} x in bare processes"
    print(f"median: {told}")


if __name__ == "__main__":
    main()
