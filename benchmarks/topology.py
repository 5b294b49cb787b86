"""Measure violations of TC1-TC5, and convergence times beside those of the slowest mode, over many starts.

```sh
export OPENBLAS_NUM_THREADS=1
python benchmarks/topology.py --missions 100 --jobs 2 --json tree.jsonl  # random trees of units
python benchmarks/topology.py --share nearest --rival tree.jsonl --json nearest.jsonl  # the paper's pairs
python benchmarks/topology.py --network lossy --json lossy.jsonl         # 30 % lost, up to 0.5 s late
python benchmarks/topology.py --kill --json killed.jsonl                 # one unit dies, for good
python benchmarks/topology.py --start star --json star.jsonl             # star of 16 under three units
python benchmarks/topology.py --radio 1.3 --form chain --units 3 12      # radio to neighbours only
python benchmarks/topology.py --clocks 5 --json clocks.jsonl             # clocks 5 s off, drifting
python benchmarks/topology.py --survivor --json survivor.jsonl           # all units die but one
python benchmarks/topology.py --compare tree.jsonl nearest.jsonl         # times of one over the other
```

With `--radio M` the radio range is M times the minimum range that connects all units at the start. Units
beyond it are reached by relay. `cut_s` is the time for which the radio graph of the living units was
disconnected. No protocol can keep P then, since a unit out of reach and a dead one are indistinguishable.
`min_gap_m` is the smallest distance between two bodies. `formed_before` is whether the shape had been reached
before a death.

Each mission that ends adds a line of JSON, and an existing file is resumed. Times and violations count from
the completion of the tree; robots stand still before. `predicted_s` is the time when `k ∫ λ dt` over the
actual topologies reaches `log(error at the start / 0.01)`. It is exact for points without limits and an error
in the slowest mode only. `driving_s` is the time of the longest path at maximum speed, a lower bound for any
control. Where the slowest mode is fast it is the longer of the two, and times are compared with
`predicted_s + driving_s`. `one_unit_s` is the prediction for a single unit that controls all robots. With
`--rival` a mission ends, unfinished, at GIVE_UP times the time of the same one there: missions with slow
pairs would last for hours.
"""

import argparse
import json
import os
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt
from rows import gather, read_rows
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import pdist, squareform

from skyherd.control import slowest_rate
from skyherd.datasets import Mission, make_mission, random_crowd, random_mission, star_mission
from skyherd.loop import Step, run_steps

GOAL = 0.01
GIVE_UP = 12.0
LOSSY = {"message_loss": 0.3, "delay_s": 0.5, "repeats": 0.2}
AFTER_DEATH_S = 300.0
DRIFT_PPM = 100.0


def mission_tree(seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Return the scenario of one mission."""
    rng = np.random.default_rng([seed, 72])
    if options.start == "star":
        tree = star_mission(seed)
    elif options.kill or options.survivor or options.units or options.form != "random":
        crowd = random_crowd(rng, tuple(options.units or (3, 8)))
        tree = random_mission(seed, replace(crowd, form=options.form))
    else:
        tree = random_mission(seed)
    tree["selection"]["share"] = options.share
    tree["perception"] = options.perception
    if options.network == "lossy":
        tree["network"] = LOSSY
        tree["robots"]["timeout_s"] = 2.0
    if options.radio:
        places_m = [unit["position_m"] for unit in tree["units"]]
        tree["network"] = tree.get("network", {}) | {"range_m": options.radio * min_range_m(places_m)}
    if options.clocks:
        for unit in tree["units"]:
            unit["clock_offset_s"] = float(options.clocks * rng.uniform(-1, 1))
            unit["clock_drift_ppm"] = float(DRIFT_PPM * rng.uniform(-1, 1))
        tree["robots"] |= {"clock_offset_s": options.clocks, "clock_drift_ppm": DRIFT_PPM}
    if options.survivor:
        left, at_s = int(rng.integers(len(tree["units"]))), float(rng.uniform(15, 60))
        spread_s = float(rng.choice([0.0, 20.0]))
        for number, unit in enumerate(tree["units"]):
            if number != left:
                unit["outages"] = [[at_s + spread_s * float(rng.random()), 1e6]]
    if options.kill:
        victim, at_s = int(rng.integers(len(tree["units"]))), float(rng.uniform(15, 60))
        tree["units"][victim]["outages"] = [[at_s, 1e6]]
    return tree


def min_range_m(places_m: npt.ArrayLike) -> float:
    """Return the minimum radio range, m, that connects all units at places (U, 2)."""
    apart_m = squareform(pdist(np.asarray(places_m)))
    return float(minimum_spanning_tree(apart_m).toarray().max())


class Watch:
    """Records a mission step by step, from ground truth."""

    def __init__(self, mission: Mission, death_s: float | None) -> None:
        scenario = mission.scenario
        self.gain, self.limit_mps = scenario.control.k, scenario.robots.max_speed_mps
        self.points, self.ids, self.death_s = mission.template.points_px, mission.ids, death_s
        self.starts_m, self.driving_s = mission.positions_m, 0.0
        self.ready_s: float | None = None
        self.reached_s: float | None = None
        self.back_s: float | None = None
        self.covered_s: float | None = None
        self.violated_s = dict.fromkeys(("p", "tc1", "tc2"), 0.0)
        self.longest_s, self._since_s = 0.0, 0.0
        self.switches, self._sets, self._rate = 0, {}, 0.0
        self.log_need = self.log_have = 0.0
        self.predicted_s: float | None = None
        self.last_s = 0.0
        self.cut_s, self.min_gap_m = 0.0, float("inf")
        self._scenario = scenario

    def see(self, step: Step) -> None:
        """Record one step."""
        passed_s, self.last_s = step.time_s - self.last_s, step.time_s
        self._watch_radio_and_bodies(step, passed_s)
        words = [frame.decision.report.tree for frame in step.frames.values()]
        if self.ready_s is None:
            if any(word is not None and word.ready for word in words):
                self.ready_s = step.time_s
                self.log_need = float(np.log(step.metrics.shape.error / GOAL))
            return
        if self.predicted_s is None:
            self.log_have += self.gain * self._rate * passed_s
            if self.log_have >= self.log_need:
                self.predicted_s = step.time_s - self.ready_s
        conditions = step.metrics.conditions
        holds = {"p": conditions.in_p, "tc1": conditions.tc1, "tc2": conditions.tc2}
        for name, hold in holds.items():
            self.violated_s[name] += 0.0 if hold else passed_s
        self._since_s = 0.0 if conditions.in_p else self._since_s + passed_s
        self.longest_s = max(self.longest_s, self._since_s)
        sets = {unit: members.tobytes() for unit, members in step.control_sets.items()}
        if sets != self._sets:
            self.switches += bool(self._sets)
            self._sets = sets
            rows = [np.searchsorted(self.ids, members) for members in step.control_sets.values()]
            self._rate = slowest_rate(self.points, rows)
        if self.death_s is not None and step.time_s > self.death_s:
            self._recover(step, conditions.in_q)
        if self.reached_s is None and step.metrics.shape.error < GOAL:
            self.reached_s = step.time_s - self.ready_s
            moved_m = np.linalg.norm(step.positions_m - self.starts_m, axis=1)
            self.driving_s = float(moved_m.max()) / self.limit_mps

    def _watch_radio_and_bodies(self, step: Step, passed_s: float) -> None:
        """Record how long the radio graph of the living units was disconnected, and the smallest body gap."""
        scenario = self._scenario
        radius_m = scenario.robots.body_radius_sides * scenario.marker.side_m
        self.min_gap_m = min(self.min_gap_m, float(pdist(step.positions_m).min()) - 2 * radius_m)
        range_m, dead = scenario.network.range_m, scenario.dead_units(step.time_s)
        living = np.setdiff1d(np.arange(len(scenario.units)), dead)
        if range_m is not None and living.size > 1:
            self.cut_s += passed_s * (min_range_m(step.fleet.positions_m[living]) > range_m)

    def _recover(self, step: Step, in_q: bool) -> None:
        """Record when TC1-TC2 hold after a death, and when each robot is seen by a unit that controls it."""
        assert self.death_s is not None
        if self.back_s is None and in_q:
            self.back_s = step.time_s - self.death_s
        held = [
            np.intersect1d(frame.decision.report.controlled_ids, frame.sight.detections.ids)
            for frame in step.frames.values()
        ]
        if self.covered_s is None and in_q and np.unique(np.concatenate(held)).size == self.ids.size:
            self.covered_s = step.time_s - self.death_s

    def done(self, step: Step) -> bool:
        """Return whether the rest of the mission adds no information."""
        if self.death_s is None:
            return self.reached_s is not None and self.predicted_s is not None
        converged = step.metrics.shape.error < GOAL
        return step.time_s > self.death_s and (
            (converged and self.covered_s is not None) or step.time_s > self.death_s + 2 * AFTER_DEATH_S
        )


@cache
def rival_times(path: Path | None) -> dict[int, float]:
    """Return the time to 1 %, s, of the missions in a file of rows."""
    rows = read_rows(path) if path else []
    return {row["seed"]: row["time_to_1pct_s"] for row in rows if row.get("time_to_1pct_s") is not None}


def run_mission(seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Run one mission to its end and return its row."""
    started = perf_counter()
    try:
        tree = mission_tree(seed, options)
        mission = make_mission(tree)
    except RuntimeError as error:
        return {"seed": seed, "error": str(error)}
    deaths = sorted(unit.outages[0][0] for unit in mission.scenario.units if unit.outages)[-1:]
    give_up_s = GIVE_UP * rival_times(options.rival).get(seed, np.inf)
    watch = Watch(mission, min(deaths, default=None))
    step = None
    for step in run_steps(mission):
        watch.see(step)
        if watch.done(step):
            break
        if watch.reached_s is not None and not deaths and step.time_s > 3 * (watch.reached_s + 60):
            break
        if watch.reached_s is None and watch.ready_s is not None and step.time_s - watch.ready_s > give_up_s:
            break
    assert step is not None
    error = step.metrics.shape.error
    row = {
        "seed": seed,
        "units": len(mission.scenario.units),
        "robots": int(mission.ids.size),
        "converged": bool(watch.reached_s is not None and (not deaths or error < GOAL)),
        "time_to_1pct_s": watch.reached_s,
        "predicted_s": watch.predicted_s,
        "driving_s": watch.driving_s,
        "one_unit_s": max(watch.log_need, 0.0) / watch.gain,
        "ready_s": watch.ready_s,
        "p_violation_s": watch.violated_s["p"],
        "tc1_violation_s": watch.violated_s["tc1"],
        "tc2_violation_s": watch.violated_s["tc2"],
        "longest_violation_s": watch.longest_s,
        "switches": watch.switches,
        "cut_s": watch.cut_s,
        "min_gap_m": watch.min_gap_m,
        "shape_error": error,
        "simulated_s": step.time_s,
        "wall_s": perf_counter() - started,
    }
    if deaths:
        formed_s = np.inf if watch.reached_s is None else (watch.ready_s or 0.0) + watch.reached_s
        row |= {"death_s": watch.death_s, "formed_before": bool(formed_s < min(deaths))}
        row |= {"tc12_back_s": watch.back_s, "covered_s": watch.covered_s}
    return {key: round(value, 4) if isinstance(value, float) else value for key, value in row.items()}


def summarize(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the summary of all rows."""
    good = [row for row in rows if "error" not in row]
    times = np.array([row["time_to_1pct_s"] for row in good if row["time_to_1pct_s"] is not None])
    reached = [row for row in good if row["time_to_1pct_s"] is not None and row["predicted_s"]]
    ratios = np.array([row["time_to_1pct_s"] / row["predicted_s"] for row in reached])
    bounds = np.array([row["time_to_1pct_s"] / (row["predicted_s"] + row["driving_s"]) for row in reached])
    summary = {
        "missions": len(good),
        "no_start": len(rows) - len(good),
        "converged": sum(row["converged"] for row in good),
        "inside_p_throughout": sum(row["p_violation_s"] == 0 for row in good),
        "longest_violation_s": max((row["longest_violation_s"] for row in good), default=0.0),
        "longest_violation_of_those_never_cut_s": max(
            (row["longest_violation_s"] for row in good if not row.get("cut_s")), default=0.0
        ),
        "missions_cut": sum(bool(row.get("cut_s")) for row in good),
        "ready_max_s": max((row["ready_s"] or np.inf for row in good), default=0.0),
        "min_gap_m": min((row.get("min_gap_m", np.inf) for row in good), default=np.inf),
        "switches_median": float(np.median([row["switches"] for row in good])),
    }
    if times.size:
        summary |= {"time_median_s": float(np.median(times)), "time_max_s": float(times.max())}
    if ratios.size:
        summary |= {
            "time_over_predicted_median": float(np.median(ratios)),
            "time_over_predicted_max": float(ratios.max()),
            "time_over_1.5_predicted": int(np.sum(ratios > 1.5)),
            "time_over_predicted_and_driving_max": float(bounds.max()),
        }
    deaths = [row for row in good if "death_s" in row]
    if deaths:
        back = [np.inf if row["tc12_back_s"] is None else row["tc12_back_s"] for row in deaths]
        covered = [np.inf if row["covered_s"] is None else row["covered_s"] for row in deaths]
        summary |= {
            "formed_before_the_death": sum(row["formed_before"] for row in deaths),
            "tc12_back_within_30s": int(np.sum(np.array(back) <= 30)),
            "covered_within_30s": int(np.sum(np.array(covered) <= 30)),
            "covered_median_s": float(np.median(covered)),
        }
    return summary


def compare(ours: list[dict[str, Any]], theirs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return times of the second file over those of the first, by seed; unfinished ones at their duration.

    Both count from the completion of the tree. Quantiles above GIVE_UP are lower bounds.
    """

    def times(rows: list[dict[str, Any]]) -> dict[int, float]:
        return {
            row["seed"]: row["simulated_s"] - row["ready_s"]
            if row["time_to_1pct_s"] is None
            else row["time_to_1pct_s"]
            for row in rows
            if row.get("ready_s") is not None
        }

    first, second = times(ours), times(theirs)
    ratios = np.array([second[seed] / first[seed] for seed in sorted(first.keys() & second.keys())])
    quantiles = np.quantile(ratios, [0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0])
    return {
        "missions": int(ratios.size),
        "ratio_quantiles_0_5_25_50_75_95_100": [round(float(value), 2) for value in quantiles],
        "slower_by_over_1.2": int(np.sum(ratios < 1 / 1.2)),
    }


def main() -> None:
    """Read the command line, run the missions and print the summary."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--missions", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="of the first mission")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--json", type=Path, help="file of rows, gone on with if it is there")
    parser.add_argument("--share", choices=["leverage", "nearest"], default="leverage")
    parser.add_argument("--rival", type=Path, help="rows of the missions to be held against")
    parser.add_argument("--network", choices=["perfect", "lossy"], default="perfect")
    parser.add_argument("--perception", choices=["noisy", "ideal", "rendered"], default="noisy")
    parser.add_argument("--start", choices=["random", "star"], default="random")
    parser.add_argument("--form", choices=["random", "chain", "star"], default="random", help="of the units")
    parser.add_argument("--units", nargs=2, type=int, metavar=("LEAST", "MOST"))
    parser.add_argument("--radio", type=float, help="range, over the least that connects the start")
    parser.add_argument("--clocks", type=float, help="s; greatest offset of a clock")
    parser.add_argument(
        "--survivor", action="store_true", help="all units die but one, at once or within 20 s"
    )
    parser.add_argument("--kill", action="store_true", help="one unit dies at a random time")
    parser.add_argument("--compare", nargs=2, type=Path, metavar=("OURS", "THEIRS"))
    options = parser.parse_args()
    if options.compare:
        print(json.dumps(compare(*(read_rows(path) for path in options.compare)), indent=1))
        return
    seeds = range(options.seed, options.seed + options.missions)
    rows = gather(partial(run_mission, options=options), seeds, options.jobs, options.json)
    print(json.dumps(summarize(rows), indent=1))


if __name__ == "__main__":
    main()
