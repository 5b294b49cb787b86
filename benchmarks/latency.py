"""Measure the largest stable gain and the settling time by latency, with and without compensation.

    export OPENBLAS_NUM_THREADS=1
    python benchmarks/latency.py --json latency.jsonl            # all gains, latencies, both ways: minutes
    python benchmarks/latency.py --json latency.jsonl --figure docs/live/latency.png --table latency.md

Each row is one run of a scenario on exact points. Wheels have no limits, so that latency and the time between
two decisions bound the gain; k_omega is four times k. Units take ten images a second, and robots decide as
often, or twice as often. From the star's own start, robots leave the images at large gains, which is no
measure of stability; `from near` avoids this. `settled_s` is the time from which the shape error stays below
the scenario's goal of 0.5 %, or null. `overshoot` is the largest rise of the shape error above its earlier
minimum, relative to the error at the start. The largest stable gain is the largest gain up to which every
smaller one settled, too.
"""

import argparse
import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from rows import gather, read_rows

from skyherd.datasets import make_mission, scenario_text
from skyherd.files.atomic import write_text
from skyherd.loop import run_steps

NEAR = {"scale_m": 1.0, "jitter_m": 0.6, "spacing_m": 1.0}
"""A start near the star: each robot within 0.6 m, along x and along y, of its place in one of 1 m a unit."""

SCENARIOS: dict[str, tuple[str, float, dict[str, float] | None]] = {
    "triangle": ("triangle", 0.1, None),
    "star": ("star", 0.1, None),
    "star from near": ("star", 0.1, NEAR),
    "star from near, decided twice an image": ("star", 0.05, NEAR),
}
"""By name: the built-in scenario, time between two decisions (s), and start; None for the scenario's own."""
LATENCIES_S = (0.0, 0.1, 0.3, 1.0)
GAINS = tuple(float(f"{gain:.2g}") for gain in (*np.geomspace(0.2, 1, 5), *np.geomspace(1.25, 10, 9)))
DURATION_S, IMAGES_HZ = 40.0, 10
GOAL, MAX_OVERSHOOT = 0.005, 10.0

RUNS = [
    (scenario, latency_s, compensate, gain)
    for scenario in SCENARIOS
    for latency_s in LATENCIES_S
    for compensate in (False, True)
    for gain in GAINS
]


def run(number: int) -> dict[str, Any]:
    """Run one scenario and return its row."""
    scenario, latency_s, compensate, gain = RUNS[number]
    built_in, step_s, start = SCENARIOS[scenario]
    tree = tomllib.loads(scenario_text(built_in))
    tree |= {"perception": "ideal", "duration_s": DURATION_S, "step_s": step_s}
    tree["control"] |= {"rectify": False, "k": gain, "k_omega": 4 * gain, "latency_compensation": compensate}
    tree["robots"] |= {"max_speed_mps": 1000, "max_turn_radps": 1000, "timeout_s": latency_s + 0.5}
    if start is not None:
        del tree["robots"]["positions_m"], tree["robots"]["headings_deg"]
        tree["robots"]["scatter"] = start
    for unit in tree["units"]:
        unit |= {"latency_s": latency_s, "frame_rate_hz": IMAGES_HZ}
    errors = np.array([step.metrics.shape.error for step in run_steps(make_mission(tree))])
    times_s = np.linspace(0.0, DURATION_S, errors.size)
    above = np.flatnonzero(~(errors < GOAL))
    settled = above.size == 0 or above[-1] + 1 < errors.size
    rises = errors - np.minimum.accumulate(errors)
    return {
        "seed": number,
        "scenario": scenario,
        "latency_s": latency_s,
        "compensate": compensate,
        "gain": gain,
        "settled_s": float(times_s[above[-1] + 1 if above.size else 0]) if settled else None,
        "overshoot": float(rises.max() / errors[0]),
        "end_error": float(errors[-1]),
    }


def select(rows: list[dict[str, Any]], **wanted: Any) -> list[dict[str, Any]]:
    """Return the rows with these values, by ascending gain."""
    found = [row for row in rows if all(row[key] == value for key, value in wanted.items())]
    return sorted(found, key=lambda row: row["gain"])


def largest_stable(rows: list[dict[str, Any]]) -> float | None:
    """Return the largest gain below which every gain settled, from the smallest that did.

    The smallest gains may be too slow to settle within a run, so the range begins at the first that settled.
    """
    best = None
    for row in rows:
        if row["settled_s"] is not None:
            best = row["gain"]
        elif best is not None:
            break
    return best


def table(rows: list[dict[str, Any]]) -> str:
    """Return a Markdown table of the largest gain and the fastest run by scenario and latency."""
    lines = [
        "| scenario | latency, s | largest stable k, 1/s | compensated | ratio | "
        "least time to settle, s | compensated | overshoot at k = 1 /s | compensated |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for scenario in SCENARIOS:
        for latency_s in LATENCIES_S:
            gains, times, overs = [], [], []
            for compensate in (False, True):
                here = select(rows, scenario=scenario, latency_s=latency_s, compensate=compensate)
                gains.append(largest_stable(here))
                settled = [row["settled_s"] for row in here if row["settled_s"] is not None]
                times.append(f"{min(settled):.1f}" if settled else "–")
                overs += [f"{row['overshoot']:.1%}" for row in here if row["gain"] == 1.0]
            ratio = f"{gains[1] / gains[0]:.1f}" if all(gains) else "–"
            shown = [f"{gain:g}" if gain else "–" for gain in gains]
            lines.append(
                f"| {scenario} | {latency_s:g} | " + " | ".join([*shown, ratio, *times, *overs]) + " |"
            )
    return "\n".join(lines) + "\n"


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw settling time and overshoot over the gain, one column a scenario, one colour a latency."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.lines import Line2D

    figure, axes = pyplot.subplots(2, len(SCENARIOS), figsize=(13, 6), sharex=True, sharey="row")
    colours = ("#222222", "#0072b2", "#e69f00", "#d55e00")
    for column, scenario in enumerate(SCENARIOS):
        for latency_s, colour in zip(LATENCIES_S, colours, strict=True):
            for compensate in (False, True):
                here = select(rows, scenario=scenario, latency_s=latency_s, compensate=compensate)
                gains = [row["gain"] for row in here]
                settled = [np.nan if row["settled_s"] is None else row["settled_s"] for row in here]
                overshoot = [min(row["overshoot"], MAX_OVERSHOOT) for row in here]
                style = {"linestyle": "-" if compensate else "--", "color": colour, "marker": "."}
                axes[0, column].plot(gains, settled, **style)
                axes[1, column].plot(gains, overshoot, **style)
        axes[0, column].set_title(scenario.replace(", ", ",\n"), fontsize=11)
        axes[1, column].set_xlabel("gain k, 1/s")
    axes[0, 0].set(xscale="log", yscale="log", ylabel="time to 0.5 % shape error, s")
    axes[1, 0].set_yscale("symlog", linthresh=0.01)
    axes[1, 0].set(ylim=(0, 1.3 * MAX_OVERSHOOT), ylabel="overshoot, share of the start")
    for axis in axes.flat:
        axis.grid(alpha=0.3)
        axis.xaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_major_formatter("{x:g}")
        axis.label_outer()
    handles = [
        Line2D([], [], color=colour, label=f"latency {latency_s:g} s")
        for latency_s, colour in zip(LATENCIES_S, colours, strict=True)
    ]
    handles += [
        Line2D([], [], color="#666666", linestyle=style, label=label)
        for style, label in (("--", "goals as they come"), ("-", "compensated"))
    ]
    figure.legend(handles=handles, loc="upper center", ncols=len(handles), frameon=False)
    figure.tight_layout(rect=(0, 0, 1, 0.94))
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run the missing rows and draw all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", type=Path, default=Path("latency.jsonl"))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--table", type=Path)
    options = parser.parse_args()
    gather(run, range(len(RUNS)), options.jobs, options.json)
    rows = read_rows(options.json)
    if options.figure:
        draw(rows, options.figure)
    if options.table:
        write_text(options.table, table(rows))
    print(table(rows))
    print(json.dumps({"rows": len(rows)}))


if __name__ == "__main__":
    main()
