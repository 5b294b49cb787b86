"""The paper's second simulation (Fig. 5), by the safety radius and by the protocol.

    python benchmarks/figure5.py [--out docs/figure5.png]

Published are the start, the template, and from the plots V = 197 at the start and heights that settle near
11 m; the end positions are not given beyond the shape. Which robots each unit controls at the start is not
known, so that V there depends on the safety radius. Prints the figures as JSON.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from skyherd.datasets import load_mission
from skyherd.drawing.palette import UNIT_COLORS
from skyherd.loop import Step, run_steps

PUBLISHED_V = 197.0
PUBLISHED_HEIGHT_M = 11.0
RULES = {"safety radius": "radius", "protocol": "tree"}
SETTINGS = ["perception=ideal", "duration_s=120", "control.b_th=0"]


def run(kind: str) -> list[Step]:
    """Steps of the star under one rule; the protocol flies so as to serve its sets."""
    settings = [*SETTINGS, f"selection.kind={kind}"]
    if kind == "tree":
        settings += [f"units.{unit}.flight.kind=keep-in-view" for unit in range(3)]
    return list(run_steps(load_mission("star", settings)))


def account(steps: list[Step]) -> dict[str, Any]:
    """Figures of one run."""
    errors = np.array([step.metrics.shape.error for step in steps])
    reached = np.flatnonzero(errors < 0.01)
    inside = [step.metrics.conditions.in_p for step in steps]
    return {
        "V_start_m2": round(next(step.metrics.V for step in steps if step.metrics.conditions.in_q), 1),
        "V_end_m2": float(steps[-1].metrics.V),
        "shape_error_end": float(errors[-1]),
        "time_to_1pct_s": float(steps[reached[0]].time_s) if reached.size else None,
        "scale_m": round(steps[-1].metrics.shape.scale, 3),
        "heights_end_m": steps[-1].fleet.heights_m.round(1).tolist(),
        "share_of_time_inside_P": round(float(np.mean(inside)), 3),
    }


def draw(runs: dict[str, list[Step]], path: Path) -> None:
    """Ways on the ground, V and heights of each run."""
    figure, axes = plt.subplots(2, 3, figsize=(12, 7.2), layout="constrained")
    for row, (name, steps) in enumerate(runs.items()):
        times = np.array([step.time_s for step in steps])
        ways = np.array([step.positions_m for step in steps])
        ground, cost, height = axes[row]
        for robot in range(ways.shape[1]):
            ground.plot(*ways[:, robot].T, color="0.7", linewidth=1)
        ground.plot(*ways[0].T, "o", color="0.5", markersize=3, label="start")
        ground.plot(*ways[-1].T, "o", color="black", markersize=5, label="end")
        flown = np.array([step.fleet.positions_m for step in steps])
        heights = np.array([step.fleet.heights_m for step in steps])
        shares = np.array([step.metrics.V_units for step in steps])
        for unit in range(3):
            color = UNIT_COLORS[unit]
            ground.plot(*flown[:, unit].T, color=color, linewidth=1.2)
            height.plot(times, heights[:, unit], color=color, label=f"unit {unit}")
            cost.plot(times, np.maximum(shares[:, unit], 1e-12), color=color, label=f"unit {unit}")
        cost.plot(times, [max(step.metrics.V, 1e-12) for step in steps], color="black", label="all")
        cost.axhline(PUBLISHED_V, color="0.4", linestyle=":", label="published start, 197")
        height.axhline(PUBLISHED_HEIGHT_M, color="0.4", linestyle=":", label="published end, about 11 m")
        cost.set(yscale="log", ylim=(1e-6, 1e3), xlabel="time (s)", ylabel="V (m²)")
        height.set(xlabel="time (s)", ylabel="height (m)", ylim=(0, None))
        ground.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=f"By the {name}")
        for ax in (ground, cost, height):
            ax.legend(fontsize=8, frameon=False)
            ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/figure5.png"))
    options = parser.parse_args()
    runs = {name: run(kind) for name, kind in RULES.items()}
    draw(runs, options.out)
    print(json.dumps({name: account(steps) for name, steps in runs.items()}, indent=1))


if __name__ == "__main__":
    main()
