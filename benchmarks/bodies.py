"""Measure collisions, convergence and path lengths of crowded starts with random roles.

```sh
export OPENBLAS_NUM_THREADS=1
python benchmarks/bodies.py --missions 1000 --jobs 2 --json crowded.jsonl
python benchmarks/bodies.py --network lossy --json lossy.jsonl          # 30 % lost, up to 0.5 s late
python benchmarks/bodies.py --kill --json killed.jsonl                  # one unit dies, for good
python benchmarks/bodies.py --without avoidance --json points.jsonl     # or roles, size, steering, search
python benchmarks/bodies.py --drive slip=0.05 delay_s=0.2 --json slipping.jsonl   # robots.drive
python benchmarks/bodies.py --start kind --json kind.jsonl              # starts that need no avoidance
python benchmarks/bodies.py --perception rendered --missions 20 --json rendered.jsonl
python benchmarks/bodies.py --compare points.jsonl crowded.jsonl        # times, second over first
python benchmarks/bodies.py --figure bodies.png crowded.jsonl points.jsonl
```

Missions have 6 to 40 robots under 1 to 5 units. Bodies are two marker sides across and cover 3 to 12 % of
their ground. Each mission that ends adds a line of JSON, and an existing file is resumed. Times count from
the completion of the tree; robots stand still before. `shortest_m` is the minimum total length of straight
paths into the shape, over all assignments and similarities with the requested spacing.
"""

import argparse
import json
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from rows import Row, gather, read_rows

from skyherd.analysis.shortest_paths import shortest_path
from skyherd.datasets import (
    SHAPE_SPACING,
    Crowd,
    Mission,
    crowded_mission,
    make_mission,
    random_mission,
)
from skyherd.drawing.palette import INK, unit_color
from skyherd.geometry import to_complex
from skyherd.loop import Step, run_steps
from skyherd.plots.style import DPI, drawing_style, new_figure

GOAL = 0.01
HOLD_S = 3.0
LIMIT_S = 600.0
LOSSY = {"message_loss": 0.3, "delay_s": 0.5, "repeats": 0.2}
OFF: dict[str, dict[str, Any]] = {
    "roles": {"roles": {}},
    "size": {"size": {}},
    "avoidance": {"avoidance": {}},
    "steering": {"avoidance": {"on": True, "detour": "none"}},
    "search": {"avoidance": {"on": True, "detour": "gyroscopic"}},
}
"""Scenario keys that switch each part off."""


def mission_tree(seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Return the scenario of one mission."""
    rng = np.random.default_rng([seed, 80])
    if options.start == "kind":
        tree = random_mission(seed, Crowd(int(rng.integers(1, 5)), int(rng.integers(6, 8))))
    else:
        tree = crowded_mission(seed)
    for part in options.without:
        tree |= OFF[part]
    tree |= {"perception": options.perception, "duration_s": LIMIT_S}
    if options.drive:
        tree["robots"]["drive"] = dict(options.drive)
    if options.network == "lossy":
        tree["network"] = LOSSY
        tree["robots"]["timeout_s"] = 2.0
    if options.kill and len(tree["units"]) > 1:
        victim, at_s = int(rng.integers(len(tree["units"]))), float(rng.uniform(1, 8))
        tree["units"][victim]["outages"] = [[at_s, 1e6]]
    return tree


class Watch:
    """Records a mission step by step, from ground truth."""

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.path_m, self.gap_m = 0.0, np.inf
        self.ready_s: float | None = None
        self.reached_s: float | None = None
        self.exchanges, self.collisions = 0, 0
        self._last: Step | None = None
        self._touching: set[tuple[int, ...]] = set()

    def see(self, step: Step) -> None:
        """Record one step."""
        words = [frame.decision.report.tree for frame in step.frames.values()]
        if self.ready_s is None and any(word is None or word.ready for word in words):
            self.ready_s = step.time_s
        bodies = self.mission.bodies
        self.gap_m = min(self.gap_m, float(bodies.gaps_m(step.positions_m).min()))
        touching = {tuple(pair) for pair in bodies.overlapping(step.positions_m).tolist()}
        self.collisions += len(touching - self._touching)
        self._touching = touching
        if self._last is not None:
            self.path_m += float(np.linalg.norm(step.positions_m - self._last.positions_m, axis=1).sum())
            self.exchanges += not np.array_equal(step.roles, self._last.roles)
        self._last = step
        if step.metrics.shape.error >= GOAL:
            self.reached_s = None
        elif self.reached_s is None:
            self.reached_s = step.time_s

    def done(self, step: Step) -> bool:
        """Return whether the shape was reached and held, and the planned death has happened."""
        dies_s = max(
            (unit.outages[0][0] for unit in self.mission.scenario.units if unit.outages), default=0.0
        )
        return self.reached_s is not None and step.time_s > max(self.reached_s, dies_s) + HOLD_S


def run_mission(seed: int, options: argparse.Namespace) -> Row:
    """Run one mission to its end and return its row."""
    started = perf_counter()
    try:
        mission = make_mission(mission_tree(seed, options))
    except RuntimeError as error:
        return {"seed": seed, "error": str(error)}
    watch, side_m = Watch(mission), mission.scenario.marker.side_m
    for step in run_steps(mission):
        watch.see(step)
        if watch.done(step):
            break
    shortest = shortest_path(
        mission.template.points_px.conj(),
        to_complex(mission.positions_m),
        classes=None if mission.scenario.roles.exchange else np.arange(mission.ids.size),
        spacing=(mission.scenario.size.min_spacing_sides * side_m, np.inf),
    )
    ready_s = watch.ready_s or 0.0
    row = {
        "seed": seed,
        "units": len(mission.scenario.units),
        "robots": int(mission.ids.size),
        "converged": watch.reached_s is not None,
        "time_to_1pct_s": None if watch.reached_s is None else watch.reached_s - ready_s,
        "ready_s": watch.ready_s,
        "shape_error": step.metrics.shape.error,
        "collisions": watch.collisions,
        "min_gap_sides": watch.gap_m / side_m,
        "path_m": watch.path_m,
        "shortest_m": shortest.length,
        "role_exchanges": watch.exchanges,
        "simulated_s": step.time_s,
        "wall_s": perf_counter() - started,
    }
    return {key: round(value, 4) if isinstance(value, float) else value for key, value in row.items()}


def summarize(rows: list[Row]) -> dict[str, Any]:
    """Return the summary of all rows."""
    good = [row for row in rows if "error" not in row]
    times = [row["time_to_1pct_s"] for row in good if row["converged"]]
    ratios = [row["path_m"] / row["shortest_m"] for row in good]
    return {
        "missions": len(good),
        "no_start": len(rows) - len(good),
        "converged": sum(row["converged"] for row in good),
        "with_collisions": sum(row["collisions"] > 0 for row in good),
        "min_gap_sides": min(row["min_gap_sides"] for row in good),
        "time_median_s": float(np.median(times)) if times else None,
        "time_max_s": max(times, default=None),
        "path_over_shortest_quantiles": dict(
            zip((5, 50, 95, 100), np.round(np.percentile(ratios, [5, 50, 95, 100]), 3).tolist(), strict=True)
        ),
        "role_exchanges_median": float(np.median([row["role_exchanges"] for row in good])),
        "spacing_sides": SHAPE_SPACING,
    }


def compare(first: list[Row], second: list[Row]) -> dict[str, Any]:
    """Return times of the second file over those of the first, by seed, where both converged."""
    times = [
        {row["seed"]: row["time_to_1pct_s"] for row in rows if row.get("converged")}
        for rows in (first, second)
    ]
    both = sorted(times[0].keys() & times[1].keys())
    ratios = np.array([times[1][seed] / times[0][seed] for seed in both])
    quantiles = np.round(np.percentile(ratios, [0, 5, 50, 95, 100]), 3).tolist()
    medians = [float(np.median([part[seed] for seed in both])) for part in times]
    return {"missions": len(both), "medians_s": medians, "quantiles_of_ratio": quantiles}


def draw(ours: list[Row], points: list[Row], path: Path) -> None:
    """Draw smallest gaps, path lengths and times of crowded missions, and the gaps of point robots."""
    with drawing_style():
        figure = new_figure(2.9, 9.6)
        gaps, ways, times = figure.subplots(1, 3)
        bins = np.arange(-2.0, 2.01, 0.2)
        for rows, color, label in (
            (points, unit_color(1), "without"),
            (ours, unit_color(0), "with all parts"),
        ):
            share = np.full(len(rows), 100 / len(rows))
            least = [row["min_gap_sides"] for row in rows]
            gaps.hist(least, bins, weights=share, color=color, alpha=0.8, label=f"{label}, {len(rows)}")
        gaps.axvline(0.0, ymax=0.72, color=INK, linewidth=1.0)
        gaps.set(
            xlabel="least gap between bodies (marker sides)",
            ylabel="missions (%)",
            title="touching, left of 0",
        )
        gaps.legend(loc="upper right", handlelength=1.0)
        crews = sorted({row["units"] for row in ours})
        for axes, values in (
            (ways, [[row["path_m"] / row["shortest_m"] for row in ours if row["units"] == u] for u in crews]),
            (times, [[row["time_to_1pct_s"] for row in ours if row["units"] == u] for u in crews]),
        ):
            parts = axes.boxplot(values, positions=crews, whis=(5, 95), showfliers=False, patch_artist=True)
            for box in parts["boxes"]:
                box.set(facecolor=unit_color(0), alpha=0.35)
            for middle in parts["medians"]:
                middle.set(color=INK, linewidth=1.6)
            axes.set(xlabel="units")
        ways.set(ylabel="path / shortest in hindsight", title="way of all robots")
        times.set(ylabel="time to 1 % (s)", title="time, from when the tree is ready")
        figure.savefig(path, dpi=DPI)


def _setting(text: str) -> tuple[str, float]:
    key, value = text.split("=")
    return key, float(value)


def main() -> None:
    """Run the missions, print their rows and a summary."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--missions", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the first mission")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path, help="file of rows, one a line")
    parser.add_argument("--start", choices=["crowded", "kind"], default="crowded")
    parser.add_argument("--perception", choices=["ideal", "noisy", "rendered"], default="noisy")
    parser.add_argument("--network", choices=["perfect", "lossy"], default="perfect")
    parser.add_argument("--kill", action="store_true", help="one unit dies")
    parser.add_argument("--without", nargs="*", choices=list(OFF), default=[])
    parser.add_argument("--drive", nargs="*", type=_setting, default=[], metavar="KEY=VALUE")
    parser.add_argument("--compare", nargs=2, type=Path, metavar=("FIRST", "SECOND"))
    parser.add_argument("--figure", nargs=3, type=Path, metavar=("PNG", "ROWS", "POINTS"))
    options = parser.parse_args()
    if options.figure:
        draw(*(read_rows(path) for path in options.figure[1:]), options.figure[0])
        return
    if options.compare:
        print(compare(*(read_rows(path) for path in options.compare)))
        return
    seeds = range(options.seed, options.seed + options.missions)
    rows = gather(partial(run_mission, options=options), seeds, options.jobs, options.json)
    print(json.dumps(summarize(rows), indent=1))


if __name__ == "__main__":
    main()
