"""Steps and frames a second of the loop, and where the time goes.

    python benchmarks/loop.py                    # star and grid, JSON on stdout
    python benchmarks/loop.py --quick --scenarios star

One thread, no video. `ratio_to_plain_aruco` compares a frame's detection with OpenCV's detector at its
defaults on the same frames in the same run, clean of the loop; a ratio above 1 means faster than it.
"""

import argparse
import json
import os
import platform
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any

import cv2
import numpy as np

from skyherd.control import AerialController, Team
from skyherd.datasets import load_mission
from skyherd.loop import run_steps
from skyherd.markers.dictionary import load_dictionary
from skyherd.recording.writer import McapRecorder
from skyherd.sim.perception import RenderedPerception

KEEP_EVERY = 10


class Laps:
    """Seconds spent in wrapped calls, by part."""

    def __init__(self) -> None:
        self.calls_s: dict[str, list[float]] = defaultdict(list)

    def timed(self, part: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """The same call, timed under `part`."""

        def wrapped(*args: Any, **kwargs: Any) -> Any:
            started = perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                self.calls_s[part].append(perf_counter() - started)

        return wrapped


def measure(name: str, duration_s: float) -> dict[str, Any]:
    """Run one scenario for `duration_s` of simulated time and account for its wall time."""
    mission = load_mission(name, [f"duration_s={duration_s}", "perception=rendered"])
    laps, step_s, images = Laps(), [], []
    perception = RenderedPerception(mission, np.random.default_rng(mission.scenario.seed))
    perception.renderer.render = laps.timed("render", perception.renderer.render)  # type: ignore[method-assign]
    perception.detector.detect = laps.timed("detect", perception.detector.detect)  # type: ignore[method-assign]
    originals = AerialController.step, Team.command
    AerialController.step = laps.timed("control", originals[0])  # type: ignore[method-assign]
    Team.command = laps.timed("control", originals[1])  # type: ignore[method-assign]
    try:
        with (
            tempfile.TemporaryDirectory() as folder,
            McapRecorder(Path(folder) / "run.mcap", mission) as recorder,
        ):
            write, started = laps.timed("record", recorder.write), perf_counter()
            for count, step in enumerate(run_steps(mission, perception)):
                write(step)
                if count % KEEP_EVERY == 0:
                    images += [frame.sight.image for frame in step.frames.values()]
                step_s.append(perf_counter() - started)
                started = perf_counter()
    finally:
        AerialController.step, Team.command = originals  # type: ignore[method-assign]
    return _account(name, mission.scenario.marker.dictionary, step_s, laps, images)


def _account(
    name: str, dictionary: str, step_s: list[float], laps: Laps, images: list[np.ndarray]
) -> dict[str, Any]:
    total = sum(step_s)
    spent = {part: sum(calls) for part, calls in laps.calls_s.items()}
    frames = len(laps.calls_s["detect"])
    megapixels = frames * float(np.mean([image.size for image in images])) / 1e6
    plain_s = _time_plain(dictionary, images)
    detect_s = float(np.median(laps.calls_s["detect"]))
    return {
        "scenario": name,
        "steps": len(step_s),
        "frames": frames,
        "steps_per_s": len(step_s) / total,
        "frames_per_s": frames / total,
        "megapixels_per_s": megapixels / total,
        "step_ms_median": 1e3 * float(np.median(step_s)),
        "step_ms_p99": 1e3 * float(np.percentile(step_s, 99)),
        "share": {part: seconds / total for part, seconds in spent.items()}
        | {"rest": 1 - sum(spent.values()) / total},
        "frame_ms_median": {
            part: 1e3 * float(np.median(laps.calls_s[part])) for part in ("render", "detect")
        },
        "frame_ms_p99": {
            part: 1e3 * float(np.percentile(laps.calls_s[part], 99)) for part in ("render", "detect")
        },
        "plain_aruco_ms_median": 1e3 * plain_s,
        "ratio_to_plain_aruco": plain_s / detect_s,
    }


def _time_plain(dictionary: str, images: list[np.ndarray]) -> float:
    """Median seconds of OpenCV's detector at its defaults on the frames kept."""
    plain, spent = cv2.aruco.ArucoDetector(load_dictionary(dictionary)), []
    for image in images:
        started = perf_counter()
        plain.detectMarkers(image)
        spent.append(perf_counter() - started)
    return float(np.median(spent))


def environment() -> dict[str, Any]:
    """What the figures depend on."""
    return {
        "python": sys.version.split()[0],
        "platform": platform.platform(),
        "processor": platform.processor() or platform.machine(),
        "cpus": os.cpu_count(),
        "opencv_threads": cv2.getNumThreads(),
        **{package: version(package) for package in ("skyherd", "numpy", "scipy", "opencv-python-headless")},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenarios", nargs="+", default=["star", "grid"])
    parser.add_argument("--quick", action="store_true", help="5 s of simulated time in place of 40")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    results = [measure(name, 5.0 if options.quick else 40.0) for name in options.scenarios]
    print(json.dumps({"environment": environment(), "results": results}, indent=2))


if __name__ == "__main__":
    main()
