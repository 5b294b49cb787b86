"""Measure self-rectification: rendered flights under random cameras, with and without it.

    python benchmarks/rectification.py                    # Markdown tables on stdout
    python benchmarks/rectification.py --runs 10 --part any
    python benchmarks/rectification.py --part cost

Parts:

- `any`: random cameras with tilt, non-square pixels, skew and distortion. A camera whose lens would fold
  within the image is redrawn.
- `cameras`: each test camera by name, tilted, and tilted and swaying.
- `ideal`: an ideal camera, on which rectification must do no harm.
- `cost`: time beside the detector's on the same images.

One unit hovers over 3, 6 or 16 robots that never stop (`b_th = 0`). Shape errors are means over the last
`--average` seconds. `NEES` compares the errors of the rectified centres under the true camera map with their
covariance, up to a similarity of all centres, on which no goal depends; its expected value is 1. Every flight
is kept in `--out` under the hash of its mission, and the same command resumes.
"""

import argparse
import json
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skyherd.control import Rectifier
from skyherd.datasets import CAMERAS, CameraModel, Mission, load_mission, make_mission
from skyherd.errors import InputError
from skyherd.geometry import Array, ComplexArray, apply_homography, inverse, to_complex, to_points
from skyherd.loop import Step, run_steps
from skyherd.markers.dictionary import card_side
from skyherd.messages import Detections
from skyherd.render import Camera, CameraPose, homography_image_ground, project_markers, undistort
from skyherd.sim.perception import RenderedPerception
from skyherd.sim.physics import make_world
from skyherd.sim.projected_perception import ProjectedPerception
from skyherd.study.plan import mission_key

SIZE_PX = 800
HEIGHT_M = 12.0
TRIPLE = [[0.0, 0.0], [1.0, 0.0], [0.3, 0.8]]
FLIGHT_S = 8.0
"""Duration of a flight, s. Derived: at gains of 1.2 /s, ten time constants leave a share of 1e-4."""

NEES_AT_S = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Times at which rectified points are compared with ground truth, s."""


@dataclass(frozen=True)
class Outcome:
    """One flight: mean shape error over its end, and the NEES of its rectified centres, if any."""

    shape_error: float
    nees: float


def template_points(robots: int) -> Array:
    """Return the built-in shapes of six and sixteen robots, or three points, with RMS radius 1."""
    names = {6: "triangle", 16: "star"}
    points = np.array(
        load_mission(names[robots]).scenario.template.points if robots in names else TRIPLE, dtype=float
    )
    points -= points.mean(axis=0)
    return points / np.sqrt((points**2).sum(axis=1).mean())


def random_unit(rng: np.random.Generator, *, ideal: bool) -> dict[str, Any]:
    """Return a hovering unit with its image centre over the ground's origin."""
    focal_px = float(SIZE_PX / 2 / np.tan(np.radians(rng.uniform(22, 40))))
    model: dict[str, Any] = {"size_px": (SIZE_PX, SIZE_PX), "focal_px": focal_px}
    yaw_deg, tilt_deg = float(rng.uniform(-180, 180)), np.zeros(2)
    if not ideal:
        tilt, way = 15 * np.sqrt(rng.uniform()), rng.uniform(-np.pi, np.pi)
        tilt_deg = tilt * np.array([np.cos(way), np.sin(way)])
        model |= {"aspect": float(rng.uniform(0.75, 1.33)), "skew": float(rng.uniform(-0.1, 0.1))}
        model["distortion"] = {"k1": float(rng.uniform(-0.3, 0.1))}
    u, v = np.radians(tilt_deg).tolist()
    straight = Camera((SIZE_PX, SIZE_PX), focal_px)
    pose = CameraPose((0.0, 0.0), HEIGHT_M, float(np.radians(yaw_deg)), (u, v))
    seen = apply_homography(inverse(homography_image_ground(straight, pose)), [[(SIZE_PX - 1) / 2] * 2])[0]
    return {
        "position_m": (-seen).tolist(),
        "height_m": HEIGHT_M,
        "yaw_deg": yaw_deg,
        "tilt_deg": tilt_deg.tolist(),
        "camera": model,
        "flight": {"kind": "hover"},
    }


def scenario_tree(robots: int, rng: np.random.Generator, *, ideal: bool) -> dict[str, Any]:
    """Return a flight from a random start in view of a random camera, with markers of 16 to 30 px."""
    unit, points = random_unit(rng, ideal=ideal), template_points(robots)
    metre_px = unit["camera"]["focal_px"] / HEIGHT_M
    scale_m = 0.55 * SIZE_PX / 2 / metre_px / np.linalg.norm(points, axis=1).max()
    side_m = float(rng.uniform(18, 30) / metre_px)
    return flight_tree(points, scale_m, side_m, unit, int(rng.integers(2**31)))


def flight_tree(
    points: Array, scale_m: float, side_m: float, unit: dict[str, Any], seed: int
) -> dict[str, Any]:
    """Return a flight over plain ground with avoidance; the shape's RMS radius is `scale_m`."""
    scatter = {"scale_m": scale_m, "jitter_m": 0.15 * scale_m, "spacing_m": 1.6 * side_m}
    return {
        "name": "rectification",
        "seed": seed,
        "step_s": 0.1,
        "template": {"points": points.tolist()},
        "robots": {"scatter": scatter},
        "marker": {"side_m": side_m},
        "control": {"k": 1.2, "k_omega": 4.8, "b_th": 0.0},
        "selection": {"radius": 1.5},
        "ground": {"kind": "plain"},
        "units": [unit],
    }


REDRAWN: Counter[str] = Counter()
"""Number of redrawn cameras of this call, by reason."""


def draw_mission(robots: int, seed: int, *, ideal: bool, rectify: bool, duration_s: float) -> Mission:
    """Return the mission of a seed: the first draw with an invertible lens and all robots in view.

    `REDRAWN` counts the rejected draws: lenses that fold within the image, and images that cut a robot off.
    """
    rng = np.random.default_rng([seed, robots])
    while True:
        tree = scenario_tree(robots, rng, ideal=ideal)
        tree["control"]["rectify"] = rectify
        try:
            mission = make_mission(tree | {"duration_s": duration_s})
        except InputError as error:
            REDRAWN["the lens folds the image" if "fold" in str(error) else str(error)] += 1
            continue
        marker = mission.scenario.marker
        seen = ProjectedPerception(marker.side_m, marker.dictionary).look(make_world(mission), [0], 0.0)[0]
        if seen.whole_ids.size == robots:
            return mission
        REDRAWN["a robot is not in the image"] += 1


def camera_mission(
    name: str, robots: int, seed: int, *, sway_deg: float, rectify: bool, duration_s: float
) -> Mission:
    """Return a flight under a named test camera, tilted by 10 degrees, with markers of at least 16 px.

    The formation fills 0.55 of what the image shows in its narrowest direction; a zoom lens zooms in by a
    third, and back.
    """
    rng, points = np.random.default_rng([seed, robots]), template_points(robots)
    way, model = rng.uniform(-np.pi, np.pi), CameraModel(preset=name)
    tilt_deg = 10.0 * np.array([np.cos(way), np.sin(way)])
    camera, yaw_deg = model.make(), float(rng.uniform(-180, 180))
    pose = CameraPose((0.0, 0.0), HEIGHT_M, np.radians(yaw_deg), tuple(np.radians(tilt_deg)))
    ground_image = inverse(homography_image_ground(camera, pose))
    corners = camera.corners_px
    sides = corners + np.linspace(0, 1, 9)[:, None, None] * (np.roll(corners, -1, axis=0) - corners)
    places = np.concatenate([[(np.array(camera.size_px) - 1) / 2], sides.reshape(-1, 2)])
    middle, *border = apply_homography(ground_image, undistort(camera, 1.0, places))
    reach_m = 0.55 * np.linalg.norm(np.array(border) - middle, axis=1).min() - HEIGHT_M * np.radians(sway_deg)
    scale_m = reach_m / np.linalg.norm(points, axis=1).max()
    rim = middle + reach_m * np.column_stack([np.cos(np.arange(8)), np.sin(np.arange(8))])
    seen = project_markers(camera, pose, rim, np.zeros(8), 1.0, card_side("4X4_50"))
    side_m = float(18 / seen.sides_px.min())
    unit: dict[str, Any] = {
        "position_m": (-middle).tolist(),
        "height_m": HEIGHT_M,
        "yaw_deg": yaw_deg,
        "tilt_deg": tilt_deg.tolist(),
        "camera": {"preset": name},
        "flight": {"kind": "hover"},
    }
    if sway_deg:
        unit["sway"] = {"tilt_deg": sway_deg}
    if model.zoom_k1:
        unit["zoom"] = [[0.0, 1.0], [2.0, 1.0], [3.0, 1.33], [5.0, 1.33], [6.0, 1.0]]
    tree = flight_tree(points, scale_m, side_m, unit, int(rng.integers(2**31)))
    tree["control"]["rectify"] = rectify
    return make_mission(tree | {"duration_s": duration_s})


def fly(mission: Mission, average_s: float) -> Outcome:
    """Fly one mission on rendered images."""
    cv2.setNumThreads(1)
    camera, duration_s = make_world(mission).cameras[0], mission.scenario.duration_s
    errors, told = [], []
    for step in run_steps(mission):
        if step.time_s > duration_s - average_s:
            errors.append(step.metrics.shape.error)
        if mission.scenario.control.rectify and np.isclose(step.time_s, NEES_AT_S, atol=1e-6).any():
            seen = step.frames[0].decision.detections
            told.append(nees(true_errors(step, seen, camera, step.fleet.pose(0)), seen))
    return Outcome(float(np.mean(errors)), float(np.mean(told)) if told else float("nan"))


class Flights:
    """Flights by the hash of their missions, read from a file or flown and appended to it."""

    def __init__(self, path: Path, pool: ProcessPoolExecutor, average_s: float) -> None:
        self.path, self.pool, self.average_s = path, pool, average_s
        lines = path.read_text("utf-8").splitlines() if path.exists() else []
        self._known = {row["key"]: Outcome(**row["outcome"]) for row in map(json.loads, lines)}

    def __call__(self, missions: Sequence[Mission]) -> list[Outcome]:
        """Return the outcomes of missions, in their order."""
        keys = [f"{mission_key(mission)}-{self.average_s:g}" for mission in missions]
        new = {key: m for key, m in zip(keys, missions, strict=True) if key not in self._known}
        done = self.pool.map(partial(fly, average_s=self.average_s), new.values())
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as file:
            for key, outcome in zip(new, done, strict=True):
                self._known[key] = outcome
                file.write(json.dumps({"key": key, "outcome": asdict(outcome)}) + "\n")
                file.flush()
        return [self._known[key] for key in keys]


def true_errors(step: Step, seen: Detections, camera: Camera, pose: CameraPose) -> Array:
    """Return errors (N, 2) of the rectified centres, px."""
    true_image = to_points(true_centers(step, seen, camera, pose))
    size = seen.image_size_px
    return np.asarray(seen.centers_px - (true_image * size.min() / 2 + (size - 1) / 2))


def nees(error: Array, seen: Detections) -> float:
    """Return the mean square of errors (N, 2) over the reported covariances, per degree of freedom.

    Both are taken up to a similarity of all centres, which removes four degrees of freedom.
    """
    z, off = (to_complex(each - each.mean(axis=0)) for each in (seen.centers_px, error))
    left = to_points(off - z * (np.vdot(z, off) / np.vdot(z, z)))
    squares = np.einsum("ni,nij,nj->n", left, inverse(seen.covariances[:, :2, :2]), left)
    return float(squares.sum() / (error.size - 4))


def true_centers(step: Step, seen: Detections, camera: Camera, pose: CameraPose) -> ComplexArray:
    """Return the robots' points (N,) in an ideal camera, from the true camera map.

    The ground is centred, rotated and scaled as in `skyherd.control.rectification.ground_map`.
    """
    ground_image, size = inverse(homography_image_ground(camera, pose)), np.array(camera.size_px)

    def ground(points: ComplexArray) -> ComplexArray:
        pixels = to_points(points) * size.min() / 2 + (size - 1) / 2
        return to_complex(apply_homography(ground_image, undistort(camera, pose.zoom, pixels))).conj()

    step_ = 1e-4
    right, left, down, up, *ring = ground(np.array([step_, -step_, 1j * step_, -1j * step_, 1, 1j, -1, -1j]))
    slope = ((right - left) - 1j * (down - up)) / (4 * step_)
    origin = ground(np.zeros(1, dtype=complex))[0]
    scale = slope * np.mean(np.abs(np.array(ring) - origin) / abs(slope))
    row = np.array([int(i) for i in seen.ids])
    return np.asarray((to_complex(step.positions_m[row]).conj() - origin) / scale)


def print_row(flown: Sequence[Outcome], *names: object) -> None:
    """Print median, 90 % quantile, maximum and NEES of some flights."""
    errors, told = np.array([(flight.shape_error, flight.nees) for flight in flown]).T
    honest = "" if np.isnan(told).all() else f"{np.mean(told):.2f} / {np.median(told):.2f}"
    spread = " | ".join(f"{value:.2e}" for value in (*np.quantile(errors, (0.5, 0.9)), errors.max()))
    print(f"| {' | '.join(map(str, names))} | {len(flown)} | {spread} | {honest} |", flush=True)


HEAD = "runs | shape error, median | 90 % | worst | NEES, mean / median |"


def print_any(flights: Flights, runs: int, plain_runs: int) -> None:
    print(f"| robots | | {HEAD}\n|---|---|---|---|---|---|---|")
    for rectify, count in ((True, runs), (False, plain_runs)):
        for robots in (6, 16):
            how = {"ideal": False, "rectify": rectify, "duration_s": FLIGHT_S}
            flown = flights([draw_mission(robots, seed, **how) for seed in range(count)])
            print_row(flown, robots, "rectified" if rectify else "as seen")
    print("drawn again: " + ("; ".join(f"{count}, {why}" for why, count in REDRAWN.items()) or "none"))


def print_cameras(flights: Flights, runs: int) -> None:
    print(f"| camera | robots | sway, deg | | {HEAD}\n|---|---|---|---|---|---|---|---|---|")
    for name in CAMERAS:
        for robots, sway_deg, rectify in product((6, 16), (0.0, 4.0), (True, False)):
            how = {"sway_deg": sway_deg, "rectify": rectify, "duration_s": FLIGHT_S + 2.0}
            missions = [camera_mission(name, robots, seed, **how) for seed in range(runs if rectify else 1)]
            print_row(flights(missions), name, robots, sway_deg, "rectified" if rectify else "as seen")


def print_ideal(flights: Flights, runs: int) -> None:
    print("| robots | runs | as seen, median | rectified, median | ratio, median | worst |")
    print("|---|---|---|---|---|---|")
    for robots in (3, 6, 16):
        how = {"ideal": True, "duration_s": FLIGHT_S + flights.average_s}
        plain, ours = (
            np.array(
                [
                    flight.shape_error
                    for flight in flights(
                        [draw_mission(robots, seed, rectify=rectify, **how) for seed in range(runs)]
                    )
                ]
            )
            for rectify in (False, True)
        )
        print(
            f"| {robots} | {runs} | {np.median(plain):.2e} | {np.median(ours):.2e} | "
            f"{np.median(ours / plain):.3f} | {(ours / plain).max():.3f} |",
            flush=True,
        )


def print_cost(seconds: float) -> None:
    """Print times of detector and rectifier on the same images, from 1 s on."""
    cv2.setNumThreads(1)
    mission = draw_mission(16, 0, ideal=False, rectify=True, duration_s=seconds)
    perception = RenderedPerception(mission, np.random.default_rng(0))
    detector, rectifier = perception.detector, Rectifier()
    detect_ms, rectify_ms, markers = [], [], []
    for step in run_steps(mission, perception):
        image = step.frames[0].sight.image
        assert image is not None
        start = time.perf_counter()
        seen = detector.detect(image, time_s=step.time_s, unit_id=1)
        middle = time.perf_counter()
        rectifier.rectify(seen)
        end = time.perf_counter()
        if step.time_s > 1.0:
            detect_ms.append(1e3 * (middle - start))
            rectify_ms.append(1e3 * (end - middle))
            markers.append(len(seen))
    print("| markers | tracking, ms | rectifying, ms | ratio |\n|---|---|---|---|")
    d, r = np.median(detect_ms), np.median(rectify_ms)
    print(f"| {np.mean(markers):.1f} | {d:.2f} | {r:.2f} | {r / d:.2f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", choices=["any", "cameras", "ideal", "cost", "all"], default="all")
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--plain-runs", type=int, help="of `any` as seen; as many if left out")
    parser.add_argument("--average", type=float, default=2.0, help="simulated seconds averaged over")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/rectification.jsonl"))
    options = parser.parse_args()
    few = max(options.runs // 10, 1)
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        flights, longer = (Flights(options.out, pool, n * options.average) for n in (1, 4))
        if options.part in ("cost", "all"):
            print_cost(20.0)
        if options.part in ("ideal", "all"):
            print_ideal(longer, few)
        if options.part in ("cameras", "all"):
            print_cameras(flights, few)
        if options.part in ("any", "all"):
            print_any(flights, options.runs, options.plain_runs or options.runs)


if __name__ == "__main__":
    main()
