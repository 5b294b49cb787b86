"""Measure time against megapixels, markers and cameras, and memory, beside other detectors.

    export OPENBLAS_NUM_THREADS=1
    python benchmarks/image_cost.py --json image_cost.json  # all, some ten minutes; and docs/image_cost.png
    python benchmarks/image_cost.py --only markers          # one part: pixels, markers, cameras or swarm

*Pixels*: sixteen markers of 30 px in images from 640x480 to 4K, noise 5. *Markers*: 4 to 100 of them in an
image of 1920x1440. In both, each frame is drawn, searched as a whole (`photometric`) and followed
(`tracking`). `cv2.aruco` at its defaults and the installed libraries get the same frame. All run in turn on
one thread, so that other load affects all equally. Times are medians over the frames.

*Cameras*: 1 to 16 units over the same sixteen robots. The figure is the wall time of a step of the rendered
loop in which all cameras take an image, with one job and with two.

*Swarm*: ten robots under each unit as in `benchmarks/scale.py`, 60 to 1000 rendered robots, on one core. The
figures are the time of a step in which all units take an image, and the peak memory of the process. The step
is timed when each unit searches its whole image, and again when robots are followed.
"""

import argparse
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import cv2
import numpy as np
from scale import swarm

from skyherd.datasets import Mission, make_mission
from skyherd.drawing.palette import INK, UNIT_COLORS
from skyherd.geometry import Image
from skyherd.loop import run_steps
from skyherd.plots.style import drawing_style, new_figure
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot
from skyherd.sim.perception import make_run_perception
from skyherd.sim.side_by_side import SideBySide
from skyherd.vision import create_detector

FIGURE = Path(__file__).parent.parent / "docs" / "image_cost.png"
DICTIONARY, PEER_DICTIONARY = "4X4_100", "APRILTAG_36h11"
SIDE_PX, HEIGHT_M, NOISE, BLUR_PX = 30.0, 10.0, 5.0, 0.8
SIZES_PX = ((640, 480), (1280, 960), (1920, 1440), (2560, 1920), (3840, 2160))
MARKERS = (4, 16, 36, 64, 100)
CAMERAS = (1, 2, 4, 8, 16)
UNITS = (6, 12, 25, 50, 100)
WARM_UP = 12
"""Number of first frames that do not count. Chosen: `tracking` follows by then."""

PEERS = {"apriltag3": "pupil_apriltags", "locus-tag": "locus"}
"""Detectors of other libraries, and the module that each needs."""

Row = dict[str, Any]


class Scene:
    """Markers on a jittered grid that drift from frame to frame, and the renderer that draws them."""

    def __init__(self, dictionary: str, size_px: tuple[int, int], markers: int) -> None:
        rng = np.random.default_rng([markers, *size_px])
        rows = int(np.sqrt(markers))
        columns = -(-markers // rows)
        cells = np.stack(np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5), axis=-1).reshape(-1, 2)
        view = np.array(size_px) / SIDE_PX
        room = view / (columns, rows)
        jitter = np.maximum(room - 2.2, 0.0) * rng.uniform(-0.4, 0.4, (markers, 2))
        self.positions_m = cells[:markers] * room - view / 2 + jitter
        self.headings_rad = rng.uniform(-np.pi, np.pi, markers)
        self.drift_m, self.turns_rad = rng.normal(0, 0.01, (markers, 2)), rng.normal(0, 0.02, markers)
        self.ids = np.arange(markers)
        self.camera = Camera(size_px, focal_px=HEIGHT_M * SIDE_PX)
        self.renderer = Renderer(
            dictionary, 1.0, Ground(3), Sensor(NOISE, np.random.default_rng(2)), psf_px=BLUR_PX
        )

    def draw(self, frame: int) -> Image:
        """Draw a frame. The camera moves, so that no part can be reused from the previous frame."""
        pose = CameraPose((0.02 * frame, -0.014 * frame), HEIGHT_M, 0.001 * frame)
        swing = np.sin(0.1 * frame)
        positions_m = self.positions_m + pose.position_m + self.drift_m * 10 * swing
        return self.renderer.render(
            Shot(self.camera, pose, self.ids, positions_m, self.headings_rad + self.turns_rad * frame)
        )


def timed_ms(call: Callable[..., Any], *arguments: Any, **named: Any) -> tuple[Any, float]:
    """Return the result of a call and its duration, ms."""
    started = perf_counter()
    result = call(*arguments, **named)
    return result, 1e3 * (perf_counter() - started)


def measure_images(size_px: tuple[int, int], markers: int, frames: int) -> list[Row]:
    """Return a row for drawing and for each detector: median time, ms, and share of markers found."""
    cv2.setNumThreads(1)
    names = {"photometric": DICTIONARY, "tracking": DICTIONARY, "opencv": DICTIONARY} | {
        name: PEER_DICTIONARY for name, module in PEERS.items() if find_spec(module)
    }
    scenes = {wanted: Scene(wanted, size_px, markers) for wanted in dict.fromkeys(names.values())}
    detectors = {name: create_detector(name, dictionary=wanted) for name, wanted in names.items()}
    spent: dict[str, list[float]] = {name: [] for name in ("draw", *names)}
    found: dict[str, list[int]] = {name: [] for name in names}
    for frame in range(WARM_UP + frames):
        shown = {}
        for wanted, scene in scenes.items():
            shown[wanted], took_ms = timed_ms(scene.draw, frame)
            spent["draw"].append(took_ms)
        for name, detector in detectors.items():
            seen, took_ms = timed_ms(detector.detect, shown[names[name]], time_s=frame / 10, unit_id=0)
            spent[name].append(took_ms)
            found[name].append(len(seen))
    counted = {name: times[WARM_UP * len(times) // (WARM_UP + frames) :] for name, times in spent.items()}
    return [
        {
            "what": name,
            "megapixels": size_px[0] * size_px[1] / 1e6,
            "markers": markers,
            "median_ms": float(np.median(times)),
            "mean_ms": float(np.mean(times)),
            "recall": None if name == "draw" else float(np.mean(found[name][WARM_UP:]) / markers),
        }
        for name, times in counted.items()
    ]


def ring_mission(cameras: int) -> Mission:
    """Return a mission of sixteen robots below a row of units that all see every robot."""
    grid = np.stack(np.meshgrid(np.arange(4) - 1.5, np.arange(4) - 1.5), axis=-1).reshape(-1, 2)
    rng = np.random.default_rng(5)
    return make_mission(
        {
            "name": f"cameras-{cameras}",
            "duration_s": 60.0,
            "step_s": 0.2,
            "template": {"points": grid.tolist()},
            "robots": {"positions_m": (grid + rng.uniform(-0.2, 0.2, grid.shape)).tolist()},
            "marker": {"side_m": 0.25, "dictionary": DICTIONARY},
            "selection": {"kind": "tree"},
            "units": [
                {
                    "position_m": [0.1 * unit, 0.0],
                    "height_m": 6.0,
                    "yaw_deg": 20.0 * unit,
                    "camera": {"half_angle_deg": 30.0, "size_px": [640, 480]},
                    "frame_rate_hz": 5.0,
                }
                for unit in range(cameras)
            ],
        }
    )


def measure_cameras(cameras: int, jobs: int, steps: int) -> Row:
    """Return the wall time of a step of the rendered loop while robots are followed."""
    mission = ring_mission(cameras)
    with SideBySide(make_run_perception(mission), jobs) as perception:
        loop = run_steps(mission, perception)
        for _ in islice(loop, WARM_UP):
            pass
        times = [timed_ms(next, loop)[1] for _ in range(steps)]
    return {"cameras": cameras, "jobs": jobs, "step_ms": float(np.median(times))}


def measure_swarm(units: int, images: int) -> Row:
    """Return the processor time of a step in which all units take an image, and the peak memory."""
    cv2.setNumThreads(1)
    mission = make_mission(swarm(units) | {"perception": "rendered"})
    times, found, whole = [], 0, 0
    loop = run_steps(mission)
    started = process_time()
    for step in loop:
        if step.frames:
            times.append(1e3 * (process_time() - started))
            found += sum(frame.sight.found_ids.size for frame in step.frames.values())
            whole += sum(frame.sight.whole_ids.size for frame in step.frames.values())
        if len(times) == images:
            break
        started = process_time()
    return {
        "units": units,
        "robots": int(mission.ids.size),
        "first_step_ms": times[0],
        "step_ms": float(np.median(times[1:])),
        "recall": found / whole,
        "memory_mib": greatest_memory_mib(),
    }


def greatest_memory_mib() -> float:
    """Return the peak memory of this process alone, MiB."""
    status = Path("/proc/self/status").read_text()
    return float(re.search(r"VmHWM:\s+(\d+) kB", status)[1]) / 1024  # type: ignore[index]


def swarm_beside(units: int, images: int) -> Row:
    """Run `measure_swarm` in a process of its own, so that its memory is measured alone."""
    command = [sys.executable, __file__, "--swarm-of", str(units), "--frames", str(images)]
    row: Row = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return row


def exponent(x: list[float], y: list[float]) -> float:
    """Return the exponent p of `y ~ x^p`, by least squares over the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def image_parts(frames: int) -> dict[str, Callable[[], Iterator[Row]]]:
    """Return the parts of the measurement by name, each of which yields its rows."""
    return {
        "pixels": lambda: (row for size in SIZES_PX for row in measure_images(size, 16, frames)),
        "markers": lambda: (row for count in MARKERS for row in measure_images((1920, 1440), count, frames)),
        "cameras": lambda: (measure_cameras(n, jobs, frames) for n in CAMERAS for jobs in (1, 2)),
        "swarm": lambda: (swarm_beside(units, 12) for units in UNITS),
    }


def draw(result: dict[str, Any], path: Path) -> None:
    """Draw four panels: times against megapixels, markers and cameras; a swarm's step and memory."""
    with drawing_style():
        figure = new_figure(8.4)
        axes = figure.subplots(2, 2).ravel()
        for panel, part, key, label in (
            (axes[0], "pixels", "megapixels", "megapixels (16 markers of 30 px)"),
            (axes[1], "markers", "markers", "markers of 30 px (1920x1440)"),
        ):
            rows = result[part]
            for color, what in zip((INK, *UNIT_COLORS), dict.fromkeys(r["what"] for r in rows), strict=False):
                x, y = zip(*[(r[key], r["median_ms"]) for r in rows if r["what"] == what], strict=True)
                panel.plot(x, y, "o--" if what == "draw" else "o-", color=color, ms=5, label=what)
            panel.set_xlabel(label)
            panel.set_ylabel("milliseconds an image, one core")
        axes[0].legend(fontsize=8)
        for jobs, color in ((1, UNIT_COLORS[0]), (2, UNIT_COLORS[1])):
            rows = [row for row in result["cameras"] if row["jobs"] == jobs]
            x, y = zip(*[(row["cameras"], row["step_ms"]) for row in rows], strict=True)
            axes[2].plot(x, y, "o-", color=color, ms=5, label=f"{jobs} job{'s' if jobs > 1 else ''}")
        axes[2].set_xlabel("cameras of 640x480, 16 robots in each")
        axes[2].set_ylabel("milliseconds a step by the clock")
        axes[2].legend()
        robots = [row["robots"] for row in result["swarm"]]
        axes[3].plot(robots, [r["step_ms"] for r in result["swarm"]], "o-", color=UNIT_COLORS[0], ms=5,
                     label="step, ms on one core")  # fmt: skip
        axes[3].plot(robots, [r["memory_mib"] for r in result["swarm"]], "s-", color=UNIT_COLORS[2], ms=5,
                     label="memory, MiB")  # fmt: skip
        axes[3].set_xlabel("robots, an image of 800x800 for ten")
        axes[3].legend()
        for panel in axes:
            panel.set(xscale="log", yscale="log")
            ticks = sorted({float(x) for line in panel.get_lines() for x in line.get_xdata()})
            panel.set_xticks(ticks, [f"{tick:.1f}" if tick % 1 else f"{tick:.0f}" for tick in ticks])
            panel.minorticks_off()
            low, high = panel.get_ylim()
            marks = [m * 10.0**p for p in range(5) for m in (1, 2, 5) if low <= m * 10.0**p <= high]
            panel.set_yticks(marks, [f"{mark:g}" for mark in marks])
        figure.savefig(path)


def main() -> None:
    """Read the command line, measure and draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=list(image_parts(1)), help="some parts")
    parser.add_argument("--frames", type=int, default=40, help="of each cell that count")
    parser.add_argument("--json", type=Path, help="file for the result, which is printed as well")
    parser.add_argument("--figure", type=Path, default=FIGURE, help="drawn if all parts are measured")
    parser.add_argument("--swarm-of", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.swarm_of:
        print(json.dumps(measure_swarm(options.swarm_of, options.frames)))
        return
    result: dict[str, Any] = {
        "python": sys.version.split()[0],
        "opencv": cv2.__version__,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
    }
    parts = image_parts(options.frames)
    for name in options.only or parts:
        result[name] = []
        for row in parts[name]():
            result[name].append(row)
            print(json.dumps(row), file=sys.stderr)
    if "swarm" in result:
        rows = result["swarm"]
        robots = [row["robots"] for row in rows]
        result["exponents"] = {
            key: exponent(robots, [row[key] for row in rows]) for key in ("step_ms", "memory_mib")
        }
    text = json.dumps(result, indent=1)
    print(text)
    if options.json:
        options.json.write_text(text + "\n")
    if not options.only:
        draw(result, options.figure)


if __name__ == "__main__":
    main()
