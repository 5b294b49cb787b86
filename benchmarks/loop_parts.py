"""Time profile of the loop: steps a second and shares of drawing, detecting, control and recording.

It runs on one thread, without video. The time of OpenCV's default detector on some of the same images is the
unit: the ratio to it is nearly equal on other machines, and on a machine with other load.
"""

import tempfile
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import cv2
import numpy as np

from skyherd.datasets import Mission, load_mission
from skyherd.geometry import Image
from skyherd.jobs.helpers import one_thread
from skyherd.loop import run_steps
from skyherd.markers.dictionary import load_dictionary
from skyherd.recording.writer import McapRecorder
from skyherd.sim.agents import make_controller
from skyherd.sim.perception import RenderedPerception, make_run_perception
from skyherd.sim.robot_teams import make_team

KEEP_EVERY = 10
"""Steps of which one is kept for OpenCV's detector. Chosen: enough images for a median, and little memory."""

PARTS = ("render", "detect", "control", "record")
"""Parts of the loop that are timed; what is left is the rest."""


class Laps:
    """Seconds spent in wrapped calls, by part.

    Attributes:
        calls_s: of each call, by part.
    """

    def __init__(self) -> None:
        self.calls_s: dict[str, list[float]] = defaultdict(list)

    def timed(self, part: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """Return the call, timed under `part`."""

        def wrapped(*args: object, **named: object) -> object:
            started = perf_counter()
            try:
                return call(*args, **named)
            finally:
                self.calls_s[part].append(perf_counter() - started)

        return wrapped

    def of(self, owner: Any, method: str, part: str) -> Any:
        """Return the object with the method of this name timed under `part`."""
        setattr(owner, method, self.timed(part, getattr(owner, method)))
        return owner


def measure_parts(name: str, duration_s: float) -> dict[str, Any]:
    """Run a scenario for `duration_s` of simulated time and account for its time.

    Returns:
        Steps and frames a second; median and 99th percentile of the time of a step (`step_ms_*`) and of a
        frame in drawing and detecting (`frame_ms_*`), ms; the share of each of `PARTS` and of the rest.
        `plain_aruco_ms_median` is the time of OpenCV's detector for a frame, ms. `ratio_to_plain_aruco` is
        its ratio to the time of our detector: above 1 ours is faster.

    Raises:
        InputError: there is no such scenario.
    """
    mission = load_mission(name, [f"duration_s={duration_s}", "perception=rendered"])
    laps = Laps()
    with one_thread():
        step_s, images = _run(mission, laps)
        plain_s = _time_plain(mission.scenario.marker.dictionary, images)
    return {"scenario": name, **account(step_s, laps.calls_s, plain_s)}


def _run(mission: Mission, laps: Laps) -> tuple[list[float], list[Image]]:
    """Return the duration of each step, s, and some of the images."""
    step_s, images = list[float](), list[Image]()
    perception = make_run_perception(mission)
    assert isinstance(perception, RenderedPerception)
    laps.of(perception.renderer, "render", "render")
    laps.of(perception.detector, "detect", "detect")
    with (
        tempfile.TemporaryDirectory() as folder,
        McapRecorder(Path(folder) / "run.mcap", mission) as recorder,
    ):
        write, started = laps.timed("record", recorder.write), perf_counter()
        steps = run_steps(
            mission,
            perception,
            controller_for=lambda mission, unit: laps.of(make_controller(mission, unit), "step", "control"),
            team_for=lambda mission, world: laps.of(make_team(mission, world), "decide", "control"),
        )
        for count, step in enumerate(steps):
            write(step)
            if count % KEEP_EVERY == 0:
                images += [
                    frame.sight.image for frame in step.frames.values() if frame.sight.image is not None
                ]
            step_s.append(perf_counter() - started)
            started = perf_counter()
    return step_s, images


def account(step_s: list[float], calls_s: dict[str, list[float]], plain_s: float) -> dict[str, Any]:
    """Return the figures of `measure_parts` from the durations of all steps and calls, s."""
    total_s, frames = sum(step_s), len(calls_s["detect"])
    shares = {part: sum(calls_s[part]) / total_s for part in PARTS}
    frame_parts = ("render", "detect")
    return {
        "steps": len(step_s),
        "frames": frames,
        "steps_per_s": len(step_s) / total_s,
        "frames_per_s": frames / total_s,
        "step_ms_median": 1e3 * float(np.median(step_s)),
        "step_ms_p99": 1e3 * float(np.percentile(step_s, 99)),
        "share": shares | {"rest": 1 - sum(shares.values())},
        "frame_ms_median": {part: 1e3 * float(np.median(calls_s[part])) for part in frame_parts},
        "frame_ms_p99": {part: 1e3 * float(np.percentile(calls_s[part], 99)) for part in frame_parts},
        "plain_aruco_ms_median": 1e3 * plain_s,
        "ratio_to_plain_aruco": plain_s / float(np.median(calls_s["detect"])),
    }


def _time_plain(dictionary: str, images: list[Image]) -> float:
    """Return the median duration of OpenCV's default detector on images, s."""
    plain, spent_s = cv2.aruco.ArucoDetector(load_dictionary(dictionary)), []
    for image in images:
        started = perf_counter()
        plain.detectMarkers(image)
        spent_s.append(perf_counter() - started)
    return float(np.median(spent_s))
