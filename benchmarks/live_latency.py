"""Measure skyherd's share of a live run's latency, beside OpenCV's detector on the same images.

    python benchmarks/live_latency.py --scenario triangle star --json live_latency.jsonl
    python benchmarks/live_latency.py --only recording

The images of one camera are rendered while the robots drive, and written into a lossless video. This video is
the camera of a lab with one unit and all robots of the scenario:

- `alone`: single images in this process, without other load. It times OpenCV's detector with its own
  settings, the unit's detector, its decision, and the encoding of its messages.
- `live`: `skyherd live run` with a process for the unit and each robot, the video at its own rate. A second
  run has OpenCV's detector instead of the unit's. Stages are those of `skyherd report`.
- `recording`: the unit's loop in this process, without a log, and with logs of 0, 1 and 10 pictures a second,
  in turns. The minimum over the passes counts for each image, as other load disturbs it least. `own` is the
  processor time of the unit's thread.

*Ours* is the unit's time from the beginning of an image to its last message. `after` is the search that
follows the decision; an image that arrives earlier waits for it. `all` is both. `live` adds up medians and
percentiles of these stages; the percentile of their sum is smaller. `with waiting` adds the waits until the
unit begins and until the robot decides. Only the ways of the stream and the radio are excluded then.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np

from skyherd.datasets import load_mission
from skyherd.files.video_reader import open_clip, read_clip
from skyherd.live.lab import Lab, load_lab, make_lab
from skyherd.live.logs.frame_log import FrameLog
from skyherd.live.logs.process_log import ProcessLog
from skyherd.live.logs.view import view_of
from skyherd.live.review import make_live_report
from skyherd.live.unit_process import keep_image
from skyherd.live.wire import Envelope, encode
from skyherd.loop import run_steps
from skyherd.vision import DeferringDetector, Detector, create_detector

SCENARIOS = ("triangle", "star")
RATE_HZ = 10
IMAGES = 150
UNMEASURED = 5
OPENCV = "opencv"
PICTURES_HZ = (None, 0.0, 1.0, 10.0)


def make_video(scenario: str, path: Path, images: int) -> None:
    """Render what the first camera of a scenario sees into a video without losses."""
    settings = [f"duration_s={images / RATE_HZ}", f"units.*.frame_rate_hz={RATE_HZ}"]
    with av.open(str(path), "w") as container:
        mission = load_mission(scenario, settings)
        stream = container.add_stream("ffv1", rate=RATE_HZ)
        stream.pix_fmt = "gray"
        stream.width, stream.height = mission.scenario.units[0].camera.size_px
        for step in run_steps(mission):
            image = step.frames[0].sight.image if 0 in step.frames else None
            if image is None:
                continue
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="gray")))
        container.mux(stream.encode(None))


def lab_of(scenario: str, **changes: Any) -> Lab:
    """Return the lab of a scenario with only its first camera, robots without wheels, and changed keys."""
    tree = load_lab(scenario).model.model_dump(mode="json", exclude_none=True)
    tree["cameras"] = [{"address": "none", **changes}]
    for robot in tree["robots"]:
        robot["driver"] = "dry-run"
    return make_lab(tree)


def images_of(path: Path) -> Iterator[np.ndarray]:
    """Return the images of a video."""
    return (frame.image for frame in read_clip(open_clip(path)))


def run_alone(scenario: str, path: Path) -> dict[str, Any]:
    """Return times of single images in this process, s: medians, means and 99th percentiles."""
    lab = lab_of(scenario)
    dictionary = lab.model.markers.dictionary
    ours = create_detector(lab.camera(0).detector, dictionary=dictionary, deferring=True)
    opencv = create_detector(OPENCV, dictionary=dictionary)
    core = lab.make_unit(0)
    times: dict[str, list[float]] = {"opencv": [], "found": [], "decided": [], "encoded": [], "after": []}
    for number, image in enumerate(images_of(path)):
        time_s = number / RATE_HZ
        marks = [time.perf_counter()]
        opencv.detect(image, time_s=time_s)
        marks.append(time.perf_counter())
        found = ours.detect(image, time_s=time_s, unit_id=0)
        marks.append(time.perf_counter())
        news = core.see(found, time_s)
        marks.append(time.perf_counter())
        for message in () if news is None else news.messages:
            encode(Envelope("unit/0", time_s, message), lab.model.team)
        marks.append(time.perf_counter())
        look_around(ours, image)
        marks.append(time.perf_counter())
        if number >= UNMEASURED:
            for name, took_s in zip(times, np.diff(marks), strict=True):
                times[name].append(float(took_s))
    both = {name: np.array(values) for name, values in times.items()}
    both["ours"] = both["found"] + both["decided"] + both["encoded"]
    both["all"] = both["ours"] + both["after"]
    row: dict[str, Any] = {"scenario": scenario, "kind": "alone", "images": both["ours"].size}
    for name, values in both.items():
        row[name] = {
            "median": float(np.median(values)),
            "mean": float(values.mean()),
            "p99": float(np.percentile(values, 99)),
        }
    return row | {"ratio": ratios(row["ours"], row["opencv"])}


def look_around(detector: Detector, image: np.ndarray) -> None:
    """Run the unit's search that follows its decision on an image."""
    if isinstance(detector, DeferringDetector):
        detector.look_around(image)


def ratios(ours: dict[str, float], opencv: dict[str, float]) -> dict[str, float]:
    """Return the ratio of our time to OpenCV's, for each kind of average."""
    return {name: ours[name] / opencv[name] for name in ours}


def live_stages(lab: Lab, video: Path, folder: Path, port: int) -> dict[str, Any]:
    """Return the latency stages of a live run of a video, s, as `skyherd report` has them."""
    tree = lab.model.model_dump(mode="json", exclude_none=True)
    place = [f"tcp/127.0.0.1:{port}"]
    tree["radio"] = {"listen": place, "connect": place}
    file, run = folder / f"lab{port}.toml", folder / f"run{port}"
    file.write_text(toml_text(tree), encoding="utf-8")
    command = [sys.executable, "-m", "skyherd", "live", "run", str(file), "--out", str(run), "--dry-run"]
    subprocess.run([*command, "--cameras", str(video), "--arm"], check=True, stdout=subprocess.DEVNULL)
    stages: dict[str, Any] = make_live_report(run)["latency_s"]
    return stages


def toml_text(tree: dict[str, Any]) -> str:
    """Return a tree of plain values as TOML, with each key at the top in one line."""
    return "".join(f"{key} = {toml_value(value)}\n" for key, value in tree.items())


def toml_value(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return json.dumps(value)


def run_live(scenario: str, video: Path, folder: Path, port: int) -> dict[str, Any]:
    """Return the stages of a live run, and those with OpenCV's detector."""
    with_ours = live_stages(lab_of(scenario), video, folder, port)
    with_opencv = live_stages(lab_of(scenario, detector=OPENCV), video, folder, port + 1)
    both = ("median", "p99")
    row: dict[str, Any] = {"scenario": scenario, "kind": "live", "stages": with_ours}
    row["stages_with_opencv"] = with_opencv
    row["ours"] = {name: sum(with_ours[stage][name] for stage in ("detection", "decision")) for name in both}
    waiting = {name: sum(with_ours[stage][name] for stage in ("wait", "command")) for name in both}
    row["with_waiting"] = {name: row["ours"][name] + waiting[name] for name in both}
    row["opencv"] = {name: with_opencv["detection"][name] for name in both}
    row["ratio"] = ratios(row["ours"], row["opencv"])
    row["ratio_with_waiting"] = ratios(row["with_waiting"], row["opencv"])
    return row


def run_recording(scenario: str, path: Path, folder: Path, times: int) -> list[dict[str, Any]]:
    """Return the time of a unit's loop an image, s, without a log and at several picture rates."""
    images = list(images_of(path))
    took: dict[float | None, list[list[tuple[float, float]]]] = {rate_hz: [] for rate_hz in PICTURES_HZ}
    for number in range(times * len(PICTURES_HZ)):
        rate_hz = PICTURES_HZ[number % len(PICTURES_HZ)]
        took[rate_hz].append(loop_times(lab_of(scenario), images, folder / f"{number}.mcap", rate_hz))
    rows = []
    for rate_hz, passes in took.items():
        shortest = np.min(passes, axis=0)[UNMEASURED:]
        row: dict[str, Any] = {"scenario": scenario, "kind": "recording", "image_rate_hz": rate_hz}
        for column, name in enumerate(("loop", "own")):
            values = shortest[:, column]
            row[name] = {
                "median": float(np.median(values)),
                "mean": float(values.mean()),
                "p99": float(np.percentile(values, 99)),
            }
        rows.append(row | {"passes": times, "images": len(images)})
    return rows


def loop_times(
    lab: Lab, images: list[np.ndarray], path: Path, rate_hz: float | None
) -> list[tuple[float, float]]:
    """Return the times of a unit's unthrottled loop for each image, s, and its thread's processor times.

    Without a picture rate there is no process log.
    """
    dictionary = lab.model.markers.dictionary
    detector = create_detector(lab.camera(0).detector, dictionary=dictionary, deferring=True)
    core, width_px = lab.make_unit(0), lab.model.recording.image_width_px
    times = []
    with (
        ProcessLog(path, "unit/0", lab, 0.0) as process_log,
        FrameLog(0, rate_hz or 0.0, width_px) as frame_log,
    ):
        for number, image in enumerate(images):
            time_s = (number + 1) / RATE_HZ
            begun_s, own_s = time.perf_counter(), time.thread_time()
            found = detector.detect(image, time_s=time_s, unit_id=0)
            news = core.see(found, time_s)
            for message in () if news is None else news.messages:
                encode(Envelope("unit/0", time_s, message), lab.model.team)
            if rate_hz is not None:
                view = None if news is None else view_of(news.decision, lab.template)
                stages = dict.fromkeys(("captured_s", "arrived_s", "begun_s", "found_s", "sent_s"), time_s)
                keep_image(process_log, found, news, view, stages)
                frame_log.show(image, found, None if news is None else news.decision, view)
                for topic, record in frame_log.done():
                    process_log.keep(topic, time_s, record)
            look_around(detector, image)
            times.append((time.perf_counter() - begun_s, time.thread_time() - own_s))
    return times


def show(row: dict[str, Any]) -> None:
    """Print a row for readers."""
    text = f"{row['scenario']:9} {row['kind']:9}"
    if row["kind"] == "recording":
        rate_hz = row["image_rate_hz"]
        text += " no diary" if rate_hz is None else f" process_log, {rate_hz:g} pictures/s"
        for name in ("loop", "own"):
            text += f"  {name} {1e3 * row[name]['median']:6.2f}, {1e3 * row[name]['p99']:6.1f} ms"
            text += f", mean {1e3 * row[name]['mean']:.2f}"
    else:
        for name in ("ours", "opencv"):
            text += f"  {name} {1e3 * row[name]['median']:6.2f}, {1e3 * row[name]['p99']:6.1f} ms"
        text += "  ratio" + "".join(f" {name} {ratio:.2f}" for name, ratio in row["ratio"].items())
        if "all" in row:
            ratio = ratios(row["all"], row["opencv"])
            text += ", of all" + "".join(f" {name} {value:.2f}" for name, value in ratio.items())
        if "ratio_with_waiting" in row:
            text += f", with waiting {row['ratio_with_waiting']['median']:.2f}"
    print(text, "(median, 99th percentile)", flush=True)


def main() -> None:
    """Run the kinds of runs that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scenario", nargs="+", choices=SCENARIOS, default=list(SCENARIOS))
    parser.add_argument("--only", choices=["alone", "live", "recording"])
    parser.add_argument("--images", type=int, default=IMAGES)
    parser.add_argument("--times", type=int, default=5, help="passes of each kind of recording")
    parser.add_argument("--json", type=Path, help="rows are added to this file")
    options = parser.parse_args()
    port = 7500
    for scenario in options.scenario:
        with tempfile.TemporaryDirectory() as name:
            folder, rows = Path(name), []
            video = folder / "camera.mkv"
            make_video(scenario, video, options.images)
            if options.only in (None, "alone"):
                rows.append(run_alone(scenario, video))
                show(rows[-1])
            if options.only in (None, "live"):
                rows.append(run_live(scenario, video, folder, port))
                show(rows[-1])
            if options.only in (None, "recording"):
                rows += run_recording(scenario, video, folder, options.times)
                for row in rows[-len(PICTURES_HZ) :]:
                    show(row)
        if options.json:
            with options.json.open("a", encoding="utf-8") as file:
                file.writelines(json.dumps(row) + "\n" for row in rows)


if __name__ == "__main__":
    main()
