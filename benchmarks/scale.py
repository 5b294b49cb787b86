"""Measure the time of a unit's control step, and the growth of the loop's time with the team.

    export OPENBLAS_NUM_THREADS=1
    python benchmarks/scale.py                                # 60 to 1000 robots; JSON, and docs/scale.png
    python benchmarks/scale.py --units 6 12 --json scale.json # small teams only, no picture unless --figure

*Step*: the control step of one unit with 50 robots, two of them shared with a neighbour under the tree
protocol, over a least-squares similarity of 50 points in NumPy. Each is called once an image, so that both
find equal cache contents. Times are medians.

*Swarm*: units on a lattice, ten robots each, ideal perception, radio to the neighbours only, 5 images a
second and a world step of 0.1 s. Steps are timed once the tree is ready and robots move, as processor time
of the one thread; `fit_us` is the similarity's time in between, by which runs on other or busier machines
compare. `joined_s` is the time when all units were one tree inside P. `reached_s` is the time when the shape
error fell below 1 %.
"""

import argparse
import json
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from skyherd.control import AerialController, KeepInView, Template, TreeProtocol, TreeSettings, fit_similarity
from skyherd.datasets import make_mission
from skyherd.drawing.palette import INK, MUTED, UNIT_COLORS
from skyherd.loop import Step, run_steps
from skyherd.messages import Detections, UnitReport
from skyherd.plots.style import drawing_style, new_figure

FIGURE = Path(__file__).parent.parent / "docs" / "scale.png"
UNITS = (6, 12, 25, 50, 100)
PITCH_M = 6.0
CELL = np.array([(x, y) for y, row in ((-2, 3), (0, 4), (2, 3)) for x in np.linspace(-2.2, 2.2, row)])
"""Positions of the ten robots of a unit, m. Chosen."""

GOAL = 0.01
TIMED_S = 20.0


def swarm(units: int, seed: int = 0) -> dict[str, Any]:
    """Return a scenario of units in rows and columns, ten robots each, 0.5 m off the shape."""
    rng = np.random.default_rng([seed, 74])
    wide = int(np.ceil(np.sqrt(units)))
    centers = PITCH_M * np.array([(unit % wide, unit // wide) for unit in range(units)], dtype=float)
    grid = (centers[:, None] + CELL).reshape(-1, 2)
    return {
        "name": f"swarm-{units}",
        "seed": seed,
        "duration_s": 2000.0,
        "step_s": 0.1,
        "perception": "ideal",
        "template": {"points": (grid + rng.normal(0, 0.5, grid.shape)).tolist()},
        "robots": {
            "positions_m": (grid + rng.uniform(-0.4, 0.4, grid.shape)).tolist(),
            "headings_deg": rng.uniform(-180, 180, len(grid)).tolist(),
            "timeout_s": 1.0,
            "max_speed_mps": 0.5,
            "max_turn_radps": 2.0,
        },
        "marker": {"side_m": 0.2, "dictionary": "6X6_1000"},
        "control": {"k": 0.5, "k_omega": 2.0, "b_th": 0.0, "rectify": False},  # cameras look straight down
        "selection": {"kind": "tree"},
        "network": {"range_m": 12.5, "relay": False},
        "autopilot": {"min_height_m": 3.0, "max_height_m": 10.0, "max_speed_mps": 1.0, "max_climb_mps": 1.0},
        "units": [
            {
                "position_m": center.tolist(),
                "height_m": 9.0,
                "yaw_deg": float(rng.uniform(-180, 180)),
                "camera": {"half_angle_deg": 30.0, "size_px": [800, 800]},
                "flight": {"kind": "keep-in-view"},
                "frame_rate_hz": 5.0,
            }
            for center in centers
        ],
    }


def timed(call: Callable[[], Any]) -> float:
    """Return the duration of one call, s."""
    started = perf_counter()
    call()
    return perf_counter() - started


def make_fit(count: int = 50) -> Callable[[], Any]:
    """Return a function that fits one least-squares similarity of points."""
    rng = np.random.default_rng(0)
    template, current = (rng.normal(size=count) + 1j * rng.normal(size=count) for _ in range(2))
    return lambda: fit_similarity(template, current)


def measure_step(images: int = 400, robots: int = 50) -> dict[str, float]:
    """Time the steps of one of two units that share a pair, on every other image."""
    rng = np.random.default_rng(0)
    points = rng.uniform(50, 950, (2 * robots - 6, 2))
    template = Template.from_image_points(np.arange(len(points)), points + rng.normal(0, 5, points.shape))
    views = np.arange(robots), np.arange(robots - 6, len(points))
    agents = [
        AerialController(
            template, TreeProtocol(TreeSettings(radius=5)), KeepInView(template, desired_radius=0.75)
        )
        for _ in views
    ]
    heard: list[list[UnitReport]] = [[], []]
    fit, step_s, fit_s = make_fit(robots), [], []
    for image in range(images):
        for unit, ids in enumerate(views):
            seen = see(unit, 0.2 * image, ids, points[ids] + rng.normal(0, 0.1, 2))
            started = perf_counter()
            decision = agents[unit].step(seen, heard[unit])
            if unit == 0 and image > images // 4:
                step_s.append(perf_counter() - started)
                fit_s.append(timed(fit))
            heard[1 - unit] = [decision.report]
    return {
        "robots_in_view": robots,
        "robots_controlled": int(heard[1][0].controlled_ids.size),
        "step_us": 1e6 * float(np.median(step_s)),
        "fit_us": 1e6 * float(np.median(fit_s)),
        "ratio": float(np.median(step_s) / np.median(fit_s)),
    }


def see(unit: int, time_s: float, ids: Any, centers_px: Any) -> Detections:
    """Return an image with robots at given points."""
    count = len(ids)
    return Detections(
        unit_id=unit,
        time_s=time_s,
        image_size_px=np.array([1000, 1000]),
        ids=ids,
        centers_px=centers_px,
        headings_rad=np.zeros(count),
        sides_px=np.full(count, 20.0),
        corners_px=np.repeat(centers_px[:, None], 4, axis=1),
        covariances=np.zeros((count, 3, 3)),
    )


def is_ready(step: Step) -> bool:
    """Return whether any unit lets its robots move."""
    words = (frame.decision.report.tree for frame in step.frames.values())
    return any(word is not None and word.ready for word in words)


def measure_swarm(units: int, limit_s: float) -> dict[str, Any]:
    """Run a swarm until its shape is reached and its steps are timed."""
    mission = make_mission(swarm(units))
    fit, step_s, fit_s, seen = make_fit(), [], [], []
    times: dict[str, float] = {}
    start_error, started = None, process_time()
    for step in run_steps(mission):
        spent, observed = process_time() - started, step.metrics
        start_error = start_error or observed.shape.error
        if "ready_s" in times and step.time_s <= times["ready_s"] + TIMED_S:
            step_s.append(spent)
            fit_s.append(timed(fit))
            seen += [len(frame.sight.detections) for frame in step.frames.values()]
        if step.frames and is_ready(step):
            times.setdefault("ready_s", step.time_s)
        if observed.conditions.in_p:
            times.setdefault("joined_s", step.time_s)
        if observed.shape.error < GOAL:
            times.setdefault("reached_s", step.time_s)
        if (len(times) == 3 and step.time_s > times["ready_s"] + TIMED_S) or step.time_s > limit_s:
            break
        started = process_time()
    return {
        "units": units,
        "robots": int(mission.ids.size),
        "robots_in_view": float(np.mean(seen)),
        "step_ms": 1e3 * float(np.mean(step_s)),
        "steps_per_s": 1 / float(np.mean(step_s)),
        "images_per_s": len(seen) / float(np.sum(step_s)),
        "fit_us": 1e6 * float(np.median(fit_s)),
        "error_at_start": start_error,
        "error_at_end": observed.shape.error,
        **times,
    }


def growth(rows: list[dict[str, Any]]) -> float:
    """Return the exponent p of `time a step ~ robots^p`, by least squares over the logarithms."""
    robots, step_ms = np.log([(row["robots"], row["step_ms"]) for row in rows]).T
    return float(np.polyfit(robots, step_ms, 1)[0])


def draw(result: dict[str, Any], path: Path) -> None:
    """Draw time a step over robots, and the targets: slope one, and 20 steps/s at 1000 robots."""
    robots, step_ms = np.array([(row["robots"], row["step_ms"]) for row in result["swarms"]]).T
    with drawing_style():
        figure = new_figure(4.2)
        axes = figure.subplots()
        axes.set(xscale="log", yscale="log", xlim=(robots[0] / 1.4, robots[-1] * 1.4))
        axes.plot(robots, step_ms[-1] * robots / robots[-1], "--", color=INK, lw=1.1, label="slope 1")
        label = f"measured, slope {result['exponent']:.2f}"
        axes.plot(robots, step_ms, "o-", color=UNIT_COLORS[0], ms=6, label=label)
        axes.plot([1000], [50], "v", color=UNIT_COLORS[1], ms=8, label="20 steps/s at 1000 robots")
        axes.set_xlabel("robots (one unit for ten)")
        axes.set_ylabel("processor time a step (ms)")
        axes.set_xticks(robots, [f"{count:.0f}" for count in robots])
        axes.minorticks_off()
        ticks = [t for t in (1, 2, 5, 10, 20, 50, 100, 200) if step_ms.min() / 2 < t < 2 * step_ms.max()]
        axes.set_yticks(ticks, [str(tick) for tick in ticks])
        for row in result["swarms"]:
            text = f"{row['steps_per_s']:.0f} steps/s"
            axes.annotate(text, (row["robots"], row["step_ms"]), (0, 9), textcoords="offset points",
                          ha="right", color=MUTED, fontsize=9)  # fmt: skip
        axes.legend(loc="lower right")
        figure.savefig(path)


def main() -> None:
    """Read the command line, measure and draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--units", type=int, nargs="+", default=list(UNITS), help="sizes of the swarms")
    parser.add_argument("--limit", type=float, default=600.0, help="simulated seconds a swarm is given")
    parser.add_argument("--json", type=Path, help="file for the result, which is printed as well")
    parser.add_argument(
        "--figure", type=Path, help=f"default: {FIGURE.name} in docs/ if sizes are the default"
    )
    options = parser.parse_args()
    result: dict[str, Any] = {
        "python": sys.version.split()[0],
        "numpy": np.__version__,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "step": measure_step(),
        "swarms": [],
    }
    for units in options.units:
        result["swarms"].append(measure_swarm(units, options.limit))
        print(json.dumps(result["swarms"][-1]), file=sys.stderr)
    result["exponent"] = growth(result["swarms"]) if len(options.units) > 1 else None
    text = json.dumps(result, indent=1)
    print(text)
    if options.json:
        options.json.write_text(text + "\n")
    figure = options.figure or (FIGURE if options.units == list(UNITS) else None)
    if figure and result["exponent"]:
        draw(result, figure)


if __name__ == "__main__":
    main()
