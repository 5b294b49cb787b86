"""What self-rectification reaches: rendered flights under random cameras, with and without it.

    python benchmarks/rectification.py                    # Markdown tables on stdout
    python benchmarks/rectification.py --runs 10 --part any
    python benchmarks/rectification.py --part cost

Parts: `any`, cameras drawn at random, tilted, oblong, skew and distorting; `ideal`, where it must not hurt;
`cost`, beside the detector's on the same images. One unit hovers over 3, 6 or 16 robots that never stop
(`b_th = 0`); shape errors are means over the last `--average` seconds. `NEES` is of the rectified centres,
over their covariance, against the true camera's map; 1 is honest.
"""

import argparse
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from typing import Any

import cv2
import numpy as np

from skyherd.control import Rectifier, rectified
from skyherd.datasets import Mission, load_mission, make_mission
from skyherd.errors import InputError
from skyherd.geometry import Array, ComplexArray, apply_homography, inverse, to_complex, to_points
from skyherd.loop import Step, run_steps
from skyherd.messages import Detections
from skyherd.perception import Projected, Rendered
from skyherd.render import Camera, CameraPose, homography_image_ground
from skyherd.render.camera import undistort
from skyherd.world import World

SIZE_PX = 800
HEIGHT_M = 12.0
TRIPLE = [[0.0, 0.0], [1.0, 0.0], [0.3, 0.8]]
FLIGHT_S = 8.0
"""At gains of 1.2 /s, ten time constants: what is left of the start is a share of 1e-4."""

NEES_AT_S = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Instants whose rectified points are held against the truth."""


@dataclass(frozen=True)
class Outcome:
    """One flight: shape error averaged over its end, and the NEES of its rectified centres, if any."""

    shape_error: float
    nees: float


def template_points(robots: int) -> Array:
    """The built-in shapes of six and sixteen robots, or three points; RMS radius 1."""
    names = {6: "triangle", 16: "star"}
    points = np.array(
        load_mission(names[robots]).scenario.template.points if robots in names else TRIPLE, dtype=float
    )
    points -= points.mean(axis=0)
    return points / np.sqrt((points**2).sum(axis=1).mean())


def random_unit(rng: np.random.Generator, *, ideal: bool) -> dict[str, Any]:
    """A unit that hovers, its image's centre over the ground's origin."""
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
    """A flight from a random start, all robots in view, seen by a random camera; markers of 16 to 30 px."""
    unit, points = random_unit(rng, ideal=ideal), template_points(robots)
    metre_px = unit["camera"]["focal_px"] / HEIGHT_M
    scale_m = 0.55 * SIZE_PX / 2 / metre_px / np.linalg.norm(points, axis=1).max()
    side_m = float(rng.uniform(18, 30) / metre_px)
    scatter = {"scale_m": scale_m, "jitter_m": 0.15 * scale_m, "spacing_m": 1.6 * side_m}
    return {
        "name": "rectification",
        "seed": int(rng.integers(2**31)),
        "step_s": 0.1,
        "template": {"points": points.tolist()},
        "robots": {"scatter": scatter},
        "marker": {"side_m": side_m},
        "control": {"k": 1.2, "k_omega": 4.8, "b_th": 0.0},
        "selection": {"radius": 1.5},
        "ground": {"kind": "plain"},
        "units": [unit],
    }


def draw_mission(robots: int, seed: int, *, ideal: bool, rectify: bool, duration_s: float) -> Mission:
    """The mission of a seed: the first draw whose lens makes an image that has all robots in it."""
    rng = np.random.default_rng([seed, robots])
    while True:
        tree = scenario_tree(robots, rng, ideal=ideal)
        tree["control"]["rectify"] = rectify
        try:
            mission = make_mission(tree | {"duration_s": duration_s})
        except InputError:
            continue
        marker = mission.scenario.marker
        seen = Projected(marker.side_m, marker.dictionary).look(World(mission), [0], 0.0)[0]
        if seen.whole_ids.size == robots:
            return mission


def fly(
    seed: int, robots: int, *, ideal: bool, rectify: bool, duration_s: float, average_s: float
) -> Outcome:
    """Fly one mission on rendered images."""
    cv2.setNumThreads(1)
    mission = draw_mission(robots, seed, ideal=ideal, rectify=rectify, duration_s=duration_s)
    camera = World(mission).cameras[0]
    errors, squares = [], []
    for step in run_steps(mission):
        if step.time_s > duration_s - average_s:
            errors.append(step.observation.shape.error)
        if rectify and np.isclose(step.time_s, NEES_AT_S, atol=1e-6).any():
            squares.append(squared_errors(step, camera, pose_of(mission, step)))
    nees = float(np.mean(np.concatenate(squares)) / 2) if squares else float("nan")
    return Outcome(float(np.mean(errors)), nees)


def pose_of(mission: Mission, step: Step) -> CameraPose:
    """Where the camera truly was."""
    fleet, tilt = step.fleet, np.radians(mission.scenario.units[0].tilt_deg)
    return CameraPose(
        (float(fleet.positions_m[0, 0]), float(fleet.positions_m[0, 1])),
        float(fleet.heights_m[0]),
        float(fleet.yaws_rad[0]),
        (float(tilt[0]), float(tilt[1])),
        float(fleet.zooms[0]),
    )


def squared_errors(step: Step, camera: Camera, pose: CameraPose) -> Array:
    """Squared errors (N,) of rectified centres over their covariance, two degrees of freedom each."""
    frame = step.frames[0]
    seen = rectified(frame.sight.detections, frame.ground_map)
    true_image = to_points(true_centers(step, seen, camera, pose))
    size = seen.image_size_px
    error = seen.centers_px - (true_image * size.min() / 2 + (size - 1) / 2)
    return np.asarray(np.einsum("ni,nij,nj->n", error, inverse(seen.covariances[:, :2, :2]), error))


def true_centers(step: Step, seen: Detections, camera: Camera, pose: CameraPose) -> ComplexArray:
    """Where an ideal camera would see the robots (N,), by the true camera's map alone.

    The ground from the image's centre, turned and scaled as `skyherd.control.ground_map` says.
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


def outcomes(pool: ProcessPoolExecutor, runs: int, robots: int, **how: Any) -> Iterator[Outcome]:
    return pool.map(partial(fly, robots=robots, **how), range(runs))


def print_any(pool: ProcessPoolExecutor, runs: int, average_s: float) -> None:
    print("| robots | runs | | shape error, median | 90 % | worst | NEES |\n|---|---|---|---|---|---|---|")
    for rectify in (True, False):
        for robots in (6, 16):
            how = {"ideal": False, "rectify": rectify, "duration_s": FLIGHT_S, "average_s": average_s}
            flown = list(outcomes(pool, runs, robots, **how))
            errors, nees = np.array([(flight.shape_error, flight.nees) for flight in flown]).T
            name, honest = ("rectified", f"{nees.mean():.2f}") if rectify else ("as seen", "")
            print(
                f"| {robots} | {runs} | {name} | {np.median(errors):.2e} | {np.quantile(errors, 0.9):.2e} | "
                f"{errors.max():.2e} | {honest} |",
                flush=True,
            )


def print_ideal(pool: ProcessPoolExecutor, runs: int, average_s: float) -> None:
    print("| robots | runs | as seen, median | rectified, median | ratio, median | worst |")
    print("|---|---|---|---|---|---|")
    for robots in (3, 6, 16):
        how = {"ideal": True, "duration_s": FLIGHT_S + average_s, "average_s": average_s}
        pairs = zip(
            outcomes(pool, runs, robots, rectify=False, **how),
            outcomes(pool, runs, robots, rectify=True, **how),
            strict=True,
        )
        plain, ours = np.array([(one.shape_error, other.shape_error) for one, other in pairs]).T
        print(
            f"| {robots} | {runs} | {np.median(plain):.2e} | {np.median(ours):.2e} | "
            f"{np.median(ours / plain):.3f} | {(ours / plain).max():.3f} |",
            flush=True,
        )


def print_cost(seconds: float) -> None:
    """Times of detector and rectifier on the same images, from the second second on."""
    cv2.setNumThreads(1)
    mission = draw_mission(16, 0, ideal=False, rectify=True, duration_s=seconds)
    perception = Rendered(mission, np.random.default_rng(0))
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
    parser.add_argument("--part", choices=["any", "ideal", "cost", "all"], default="all")
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--average", type=float, default=2.0, help="simulated seconds averaged over")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        if options.part in ("cost", "all"):
            print_cost(20.0)
        if options.part in ("ideal", "all"):
            print_ideal(pool, max(options.runs // 10, 1), 4 * options.average)
        if options.part in ("any", "all"):
            print_any(pool, options.runs, options.average)


if __name__ == "__main__":
    main()
