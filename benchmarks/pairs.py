"""Measure the effect of the choice of shared pairs: the star under a path of three units.

    export OPENBLAS_NUM_THREADS=1
    python benchmarks/pairs.py                  # fifty starts

Each robot belongs to the nearest unit that sees it. Neighbours share two of the robots that both see: the two
nearest to the middle unit's image centre (the paper's rule), the two farthest apart in the template, or the
pair with the fastest slowest mode (leverage). Robots are points without limits under the paper's law, so that
`p(t) = exp(-k L t) p(0)` is exact. The result is the time to a shape error of 1 % at k = 0.5 /s.
`benchmarks/topology.py --start star` measures whole missions, in which units grow their own sets.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np
from scipy.optimize import brentq

from skyherd.control import laplacian, slowest_rate
from skyherd.datasets import Mission, make_mission, star_mission
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, to_complex
from skyherd.render import project
from skyherd.sim.physics import make_world
from skyherd.sim.truth_metrics import fit_shape

GAIN, GOAL, LONGEST_S = 0.5, 0.01, 1e5
Pair = tuple[int, int]


def seen_by(mission: Mission) -> BoolArray:
    """Return (units, robots) whether a robot lies in a unit's image at the start."""
    world = make_world(mission)
    looks = []
    for unit, camera in enumerate(world.cameras):
        points_px = project(camera, world.fleet.pose(unit), mission.positions_m)
        looks.append(((points_px >= 0) & (points_px <= np.array(camera.size_px) - 1)).all(axis=1))
    return np.array(looks)


def control_sets(owners: IntArray, pairs: Sequence[Pair]) -> list[IntArray]:
    """Return a row for each unit of a path: its own robots, and those shared with the next unit."""
    shared = {row for pair in pairs for row in pair}
    own = [set(np.flatnonzero(owners == unit).tolist()) - shared for unit in range(len(pairs) + 1)]
    ends = [(), *pairs, ()]
    return [np.array(sorted(mine.union(*ends[unit : unit + 2]))) for unit, mine in enumerate(own)]


def time_to_goal_s(points: ComplexArray, positions: ComplexArray, sets: Sequence[IntArray]) -> float:
    """Return the time when the shape error stays below `GOAL`, s; it decays mode by mode."""
    rates, modes = np.linalg.eigh(laplacian(points, sets))
    shares = modes.conj().T @ positions

    def error(time_s: float) -> float:
        return fit_shape(points, modes @ (np.exp(-GAIN * rates * time_s) * shares)).error - GOAL

    return float(brentq(error, 0.0, LONGEST_S, xtol=1e-3)) if error(0.0) > 0 else 0.0


def nearest(robots: IntArray, distances: Array) -> Pair:
    """Return the two robots nearest to a place."""
    first, second = robots[np.argsort(distances[robots], kind="stable")[:2]].tolist()
    return first, second


def widest(robots: IntArray, points: ComplexArray) -> Pair:
    """Return the two robots farthest apart in the template."""
    return max(combinations(robots.tolist(), 2), key=lambda pair: abs(points[pair[0]] - points[pair[1]]))


def choose(mission: Mission) -> dict[str, float]:
    """Return the time to the goal of one start by each rule, s."""
    positions = to_complex(mission.positions_m)
    points = mission.template.points_of(mission.ids).conj()
    places = np.array([complex(*unit.position_m) for unit in mission.scenario.units])
    seen = seen_by(mission)
    distances = np.abs(positions - places[:, None])
    owners = np.argmin(np.where(seen, distances, np.inf), axis=0)
    left, right = (np.flatnonzero(seen[unit] & seen[1]) for unit in (0, 2))

    def one_by_one(rule: Callable[[IntArray], Pair]) -> list[Pair]:
        first = rule(left)
        return [first, rule(np.setdiff1d(right, first))]

    both = ([a, b] for a in combinations(left, 2) for b in combinations(right, 2) if not set(a) & set(b))
    pairs = {
        "nearest": one_by_one(lambda robots: nearest(robots, distances[1])),
        "widest": one_by_one(lambda robots: widest(robots, points)),
        "leverage": max(both, key=lambda pair: slowest_rate(points, control_sets(owners, pair))),
    }
    return {
        rule: time_to_goal_s(points, positions, control_sets(owners, pair)) for rule, pair in pairs.items()
    }


def main() -> None:
    """Read the command line, run the starts and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--missions", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0, help="of the first start")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.missions)
    rows = [choose(make_mission(star_mission(seed))) for seed in seeds]
    times = {rule: np.array([row[rule] for row in rows]) for rule in rows[0]}
    for rule, taken in times.items():
        ratios = np.quantile(times["nearest"] / taken, [0, 0.25, 0.5, 0.75, 1]).round(1).tolist()
        median = round(float(np.median(taken)), 1)
        factor = round(float(np.median(times["nearest"])) / median, 1)
        told = {
            "rule": rule,
            "median_s": median,
            "median_over": factor,
            "nearest_over_0_25_50_75_100": ratios,
        }
        print(json.dumps(told))


if __name__ == "__main__":
    main()
