"""Measure whether units below a ceiling that they do not know bring a team into its shape.

```sh
export OPENBLAS_NUM_THREADS=1
python benchmarks/halls.py --runs 60 --json runs/halls.jsonl   # the file continues an interrupted run
python benchmarks/halls.py --runs 3 --told                     # the units are told their ceilings
python benchmarks/halls.py --runs 20 --scramble 4              # `scramble` with random starts below 4 m
```

Each run is the scenario `crowd` with another seed, projected noisy markers, one to three units, and a ceiling
of 4 to 6 m. The units start at random places, at the ceiling or below it. They learn it
(`skyherd.control.flight.keep_in_view`), and patrol what they cannot see at once. A run ends once the shape is
held for 5 s. `coverable` says whether the views together cover the finished shape: some places of the units
exist, all at the ceiling and parallel to the shape, from which each robot's marker is in a view.
"""

import argparse
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rows import Row, gather

from skyherd.analysis.history import make_history
from skyherd.analysis.verdict import explain_outcome
from skyherd.datasets import Mission, load_mission
from skyherd.geometry import Array, to_points
from skyherd.loop import run_steps

CEILINGS_M = (4.0, 6.0)
"""Range of ceilings, m. Chosen: gyms and laboratories."""

HALF_ANGLES_DEG = (34.0, 37.0)
"""Range of the cameras' half angles, deg. Chosen: those of `crowd`, 34 to 36."""

START_M, START_SHARE = 1.5, (0.75, 1.0)
"""Largest coordinate of a unit's start, m, and range of its height as a share of the ceiling. Chosen: it sees
some robots."""

DURATION_S = 240.0
"""Maximum simulated time, s. Chosen: ten rounds of a patrol."""

HOLD_S = 5.0
"""Time for which the shape must be held, s. Chosen: as `goal.hold_s`."""


def load_hall(seed: int, *, told: bool = False) -> tuple[Mission, float, Array]:
    """Return the mission of one run, its ceiling, m, and the half widths (U,) of the units' views, m."""
    rng = np.random.default_rng([seed, 93])
    ceiling_m, count = float(rng.uniform(*CEILINGS_M)), int(rng.integers(1, 4))
    angles_deg = rng.uniform(*HALF_ANGLES_DEG, count)
    half_m = ceiling_m * np.tan(np.radians(angles_deg))
    units = []
    for unit in range(count):
        x_m, y_m = rng.uniform(-START_M, START_M, 2)
        height_m = ceiling_m * rng.uniform(*START_SHARE)
        # The side of a marker of 0.4 m in an image of 800 px at the ceiling.
        min_side_px = 0.4 * 400 / half_m[unit] if told else 12.0
        yaw_deg = rng.uniform(-180, 180)
        units.append(
            f"{{ position_m = [{x_m:.3f}, {y_m:.3f}], height_m = {height_m:.3f}, "
            f"yaw_deg = {yaw_deg:.1f}, camera = {{ half_angle_deg = {angles_deg[unit]:.2f} }}, "
            f'frame_rate_hz = 5.0, flight = {{ kind = "keep-in-view", min_side_px = {min_side_px:.2f} }} }}'
        )
    settings = [
        f"seed={seed}",
        "perception=noisy",
        f"duration_s={DURATION_S}",
        f"autopilot.max_height_m={ceiling_m:.3f}",
        f"units=[{', '.join(units)}]",
    ]
    return load_mission("crowd", settings), ceiling_m, half_m


def load_scramble(seed: int, ceiling_m: float) -> tuple[Mission, float, Array]:
    """Return `scramble` with random starts below one ceiling, in the form of `load_hall`."""
    settings = [
        f"seed={seed}",
        "perception=noisy",
        f"duration_s={DURATION_S}",
        f"autopilot.max_height_m={ceiling_m}",
        "units.*.frame_rate_hz=5.0",
        f"units.*.height_m={ceiling_m}",
        "robots={ count = 16, scatter = { scale_m = 0.001, jitter_m = 2.4, spacing_m = 1.0 }, "
        "max_speed_mps = 0.6, body_radius_sides = 1.0, drive = { max_accel_mps2 = 1.5 } }",
    ]
    mission = load_mission("scramble", settings)
    half_m = ceiling_m * np.tan([np.radians(unit.camera.half_angle_deg) for unit in mission.scenario.units])
    return mission, ceiling_m, half_m


def is_coverable(mission: Mission, half_m: Array) -> bool:
    """Return whether square views of half widths (U,) cover the cards of the smallest shape together."""
    shape, size = mission.template, mission.scenario.size
    side_m = mission.scenario.marker.side_m
    points_m = to_points(shape.points_px) * (size.min_spacing_sides * side_m / shape.spacing_px)
    sets: list[set[frozenset[int]]] = []
    for inner_m in half_m - side_m:
        corners = np.array([[x, y] for x in points_m[:, 0] for y in points_m[:, 1]])
        offsets = points_m - corners[:, None]
        inside = ((offsets >= 0) & (offsets <= 2 * inner_m)).all(axis=2)
        sets.append({frozenset(np.flatnonzero(row).tolist()) for row in inside if row.any()})
    full = frozenset(range(len(points_m)))
    reached = {frozenset[int]()}
    for views in sets:
        grown = {covered | view for covered in reached for view in views}
        reached = {one for one in grown if not any(one < other for other in grown)}
    return full in reached


def run_hall(seed: int, *, told: bool = False, scramble_m: float | None = None) -> Row:
    """Run one mission until its shape is held; return whether it was formed, or why not."""
    mission, ceiling_m, half_m = (
        load_hall(seed, told=told) if scramble_m is None else load_scramble(seed, scramble_m)
    )
    steps, held_s, formed_s = [], 0.0, None
    for step in run_steps(mission):
        steps.append(step)
        held_s = held_s + mission.scenario.step_s if step.metrics.shape.error < 0.01 else 0.0
        if held_s >= HOLD_S:
            formed_s = round(step.time_s - HOLD_S, 1)
            break
    gaps_m = min(mission.bodies.gaps_m(step.positions_m).min() for step in steps)
    return {
        "seed": seed,
        "ceiling_m": round(ceiling_m, 2),
        "units": half_m.size,
        "coverable": is_coverable(mission, half_m),
        "formed_s": formed_s,
        "shape_error": round(steps[-1].metrics.shape.error, 4),
        "min_gap_sides": round(float(gaps_m) / mission.scenario.marker.side_m, 3),
        "reason": "" if formed_s else explain_outcome(make_history(mission, steps)),
    }


def summarize(rows: list[Row]) -> dict[str, Any]:
    """Return the numbers of runs and of formed shapes, by coverable and by number of units."""
    summary = {}
    for coverable, units in sorted({(row["coverable"], row["units"]) for row in rows}):
        own = [row for row in rows if (row["coverable"], row["units"]) == (coverable, units)]
        times_s = [row["formed_s"] for row in own if row["formed_s"] is not None]
        summary[f"{'coverable' if coverable else 'not coverable'}, {units} units"] = {
            "runs": len(own),
            "formed": len(times_s),
            "median_s": float(np.median(times_s)) if times_s else None,
            "longest_s": max(times_s, default=None),
            "with_contacts": sum(row["min_gap_sides"] < 0 for row in own),
        }
    return summary


def main() -> None:
    """Run the missions and print their rows and a summary."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--told", action="store_true", help="tell the units their ceilings, as a marker side")
    parser.add_argument(
        "--scramble", type=float, metavar="M", help="ceiling of `scramble`, m, for random halls"
    )
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1000, help="of the first run")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path, help="file of rows, one a line")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.runs)
    rows = gather(
        partial(run_hall, told=options.told, scramble_m=options.scramble), seeds, options.jobs, options.json
    )
    print(json.dumps(summarize(rows), indent=1))


if __name__ == "__main__":
    main()
