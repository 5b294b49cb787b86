"""Measure the shape error of a star that moves, and its speed over the one asked for.

```sh
python benchmarks/moving_shapes.py                        # rendered images, about 4 minutes on two cores
python benchmarks/moving_shapes.py --perception ideal     # exact detections, about 1 minute
python benchmarks/moving_shapes.py --method complex-laplacian   # robots that measure their neighbours' places
```

The built-in scenario `star` forms its shape in 70 s, then moves for 60 s. Each row has a motion whose fastest
robot drives at about half of its top speed of 1 m/s, or at a quarter. Errors count from 10 s after the
beginning of the motion, when all robots have turned. Rates are those of the true positions: the path of their
mean, and rotation and scale of their best similarity.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import numpy as np

from skyherd.datasets import load_mission
from skyherd.loop import run_steps

MOTIONS: dict[str, dict[str, Any]] = {
    "rest": {},
    "straight": {"velocity_ps": [0.072, 0.0]},
    "straight, half of it": {"velocity_ps": [0.036, 0.0]},
    "turn": {"turn_degps": 3.3},
    "turn the other way": {"turn_degps": -3.3},
    "grow": {"growth_percent_ps": 1.0},
    "shrink": {"growth_percent_ps": -1.0},
    "circle": {"velocity_ps": [0.04, 0.0], "turn_degps": 2.0},
    "circle, turn and shrink": {"velocity_ps": [0.0, 0.04], "turn_degps": -1.5, "growth_percent_ps": -0.5},
}
"""Motions of the shape. Chosen: the fastest robot of the star, 1.6 radii from its mean, drives at 0.5 m/s."""

BEGIN_S, SETTLED_S, END_S = 70.0, 80.0, 130.0


LITERATURE = (
    "units.*.frame_rate_hz=0.02",
    "roles.exchange=false",
    "size.min_spacing_sides=0",
    "avoidance.on=false",
    "control.k=2.4",
)
"""Settings of a law from the literature. The gain had the smallest errors among 0.6, 1.2, 2.4 and 4.8 /s. At
4.8 /s robots that turn as slowly as those of `star` circle their places."""


def measure(name: str, perception: str, method: str) -> str:
    """Return one row of the table."""
    literature = () if method == "similarity" else ("control.method=" + method, *LITERATURE)
    mission = load_mission(
        "star",
        [
            f"perception={perception if method == 'similarity' else 'ideal'}",
            *literature,
            f"duration_s={END_S}",
            f"template.motion={[{'at_s': BEGIN_S} | MOTIONS[name]]}".replace("'", '"').replace('":', '"='),
        ],
    )
    times_s, errors, places_m, scales, turns_rad, middles_m = [], [], [], [], [], []
    for step in run_steps(mission):
        if step.time_s >= SETTLED_S:
            shape = step.metrics.shape
            times_s.append(step.time_s)
            errors.append(shape.error)
            places_m.append(step.positions_m.copy())
            middles_m.append(complex(*step.positions_m.mean(axis=0)))
            scales.append(shape.scale)
            turns_rad.append(shape.rotation_rad)
    passed_s = times_s[-1] - times_s[0]
    speeds_mps = np.linalg.norm(np.diff(places_m, axis=0), axis=2).sum(axis=0) / passed_s
    right, up = MOTIONS[name].get("velocity_ps", (0.0, 0.0))
    wanted_m = np.hypot(right, up) * mission.template.radius_px * float(np.mean(scales)) * passed_s
    path_m = float(np.abs(np.diff(middles_m)).sum())
    share = f"{path_m / wanted_m:.3f}" if wanted_m else "–"
    turn = np.degrees(np.unwrap(turns_rad)[[0, -1]] @ [-1, 1]) / passed_s
    growth = 100 * np.log(scales[-1] / scales[0]) / passed_s
    return (
        f"| {name} | {speeds_mps.max():.2f} | {100 * np.mean(errors):.2f} | {100 * np.max(errors):.2f} "
        f"| {share} | {turn:.2f} | {growth:.2f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--perception", default="rendered", choices=["rendered", "noisy", "ideal"])
    parser.add_argument("--method", default="similarity", choices=["similarity", "complex-laplacian"])
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    print("| motion | fastest robot, m/s | mean error, % | max error, % | speed / asked | deg/s | %/s |")
    print("|---|---|---|---|---|---|---|")
    with ProcessPoolExecutor(options.jobs) as pool:
        for row in pool.map(partial(measure, perception=options.perception, method=options.method), MOTIONS):
            print(row, flush=True)


if __name__ == "__main__":
    main()
