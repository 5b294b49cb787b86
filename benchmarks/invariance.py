"""Test Property 1 on rendered images: the triangle under random cameras of its class, in both gains.

    python benchmarks/invariance.py                   # 100 cameras, Markdown on stdout
    python benchmarks/invariance.py --cameras 20

Cameras differ in focal length (x 0.5 to 2), height, place, yaw and its rate, principal point, image size and
a zoom ramp. Markers have 14 px or more, and all robots are in view. The start is that of `triangle`, and the
gains are four times as large. Paths are compared with those of exact projection, which are equal for all
cameras. `noise alone` is exact projection with the detector's noise at each camera's scale, its median over
seeds. Every run is kept in `--out`, and the same command resumes.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from skyherd.datasets import Mission, load_mission, make_mission, read_scenario
from skyherd.study.cluster import open_client, run_missions
from skyherd.study.plan import mission_key
from skyherd.study.store import Store, open_store

FOCAL_PX, REACH_M, DURATION_S = 480.0, 6.9, 30.0
MIN_PX_PER_M, MAX_PX_PER_M = 28.5, 56.0
PIXEL_GAIN = 0.4 / 40.0
"""k_v of the pixel gains: as fast as the marker gains at 40 px/m."""


def random_unit(seed: int) -> dict[str, Any]:
    """Return a hovering unit that sees the whole start at any zoom."""
    rng = np.random.default_rng([seed, 100])
    focal_px = float(FOCAL_PX * 2 ** rng.uniform(-1, 1))
    scales = rng.uniform(MIN_PX_PER_M, MAX_PX_PER_M, 2)
    half_px = REACH_M * scales.max() * (1 + rng.uniform(0, 0.25, 2))
    shift_px = (half_px - REACH_M * scales.max()) * rng.uniform(-1, 1, 2)
    size_px = np.ceil(2 * half_px).astype(int)
    place_m = np.array([1.3, 2.8]) + rng.uniform(-0.3, 0.3, 2)
    return {
        "position_m": place_m.tolist(),
        "height_m": float(focal_px / scales[0]),
        "yaw_deg": float(rng.uniform(-180, 180)),
        "camera": {
            "size_px": size_px.tolist(),
            "focal_px": focal_px,
            "principal_point_px": ((size_px - 1) / 2 + shift_px).tolist(),
        },
        "zoom": [[0.0, 1.0], [4.0, 1.0], [float(rng.uniform(5, 12)), float(scales[1] / scales[0])]],
        "flight": {"kind": "hover", "yaw_rate_degps": float(rng.uniform(-5, 5))},
        "frame_rate_hz": 5.0,
    }


def make_run(seed: int, perception: str, gains: str = "marker", noise_seed: int = 1) -> Mission:
    """Return one flight of the triangle with robots that never stop."""
    tree = read_scenario("triangle").tree
    robots = load_mission("triangle")
    tree["robots"]["headings_deg"] = np.degrees(robots.headings_rad).tolist()
    tree["control"] = {"k": 0.4, "k_omega": 1.6, "k_v": PIXEL_GAIN, "b_th": 0.0, "gains": gains}
    tree |= {
        "duration_s": DURATION_S,
        "perception": perception,
        "seed": noise_seed,
        "units": [random_unit(seed)],
    }
    tree |= {"selection": {"radius": 1.5}, "autopilot": {"min_height_m": 1.0}, "ground": {"kind": "plain"}}
    return make_mission(tree)


def all_runs(cameras: int, noise_seeds: int) -> Iterator[tuple[tuple[Any, ...], Mission]]:
    yield ("exact",), make_run(0, "ideal")
    for seed in range(cameras):
        yield (seed, "marker"), make_run(seed, "rendered")
        yield (seed, "pixel"), make_run(seed, "rendered", "pixel")
        for noise_seed in range(1, noise_seeds + 1):
            yield (seed, "noise", noise_seed), make_run(seed, "noisy", noise_seed=noise_seed)


def fly_missing(runs: dict[str, Mission], store: Store, jobs: int) -> None:
    known = store.keys(["history.positions_m"], failed=False)
    missing = [(key, mission) for key, mission in runs.items() if key not in known]
    if missing:
        with open_client(jobs=jobs) as client:
            for outcomes in run_missions(client, missing, ["positions_m"]):
                store.append(outcomes)


def print_table(names: dict[tuple[Any, ...], str], outcomes: dict[str, dict[str, Any]], cameras: int) -> None:
    side_m = load_mission("triangle").scenario.marker.side_m

    def path(*name: Any) -> np.ndarray:
        return np.array(outcomes[names[name]]["history.positions_m"])

    def off(*name: Any) -> float:
        return float(np.linalg.norm(path(*name) - exact, axis=2).max() / side_m)

    exact = path("exact")
    seeds = sorted({name[2] for name in names if name[1:2] == ("noise",)})
    noise = np.array([np.median([off(c, "noise", s) for s in seeds]) for c in range(cameras)])
    print(
        "| gains | cameras | shape error, median | worst | paths off, marker sides, median | worst | ", end=""
    )
    print("over noise alone, median | worst |\n|---|---|---|---|---|---|---|---|")
    for gains in ("marker", "pixel"):
        errors = np.array([outcomes[names[c, gains]]["shape_error"] for c in range(cameras)])
        paths = np.array([off(c, gains) for c in range(cameras)])
        told = (errors, paths, paths / noise)
        cells = " | ".join(f"{np.median(values):.2g} | {values.max():.2g}" for values in told)
        print(f"| {gains} | {cameras} | {cells} |")
    print(f"\nnoise alone: {np.median(noise):.2g} marker sides in the median, {len(seeds)} seeds a camera")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cameras", type=int, default=100)
    parser.add_argument("--noise-seeds", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/invariance"))
    options = parser.parse_args()
    flights = list(all_runs(options.cameras, options.noise_seeds))
    names = {name: mission_key(mission) for name, mission in flights}
    with open_store(options.out, '{"study": "benchmarks/invariance.py"}\n') as store:
        fly_missing({names[name]: mission for name, mission in flights}, store, options.jobs)
        wanted = set(names.values())
        rows = [row for row in store.read().to_pylist() if row["key"] in wanted]
    print_table(names, {row["key"]: row for row in rows}, options.cameras)


if __name__ == "__main__":
    main()
