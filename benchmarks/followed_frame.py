"""Compare followed and searched frames with OpenCV's time, and bound what other code could save.

    OPENBLAS_NUM_THREADS=1 python benchmarks/followed_frame.py              # 16 markers of 30 px in 1280x960
    OPENBLAS_NUM_THREADS=1 python benchmarks/followed_frame.py --size 3840 2160

All detectors get the same frames one after the other on one thread. Times are medians of wall time over the
frames. *Followed* is `tracking` in frames in which it searches nothing, *searched* is `photometric`, and
*quick* its first search alone. *Compiled* is the time of compiled functions in a followed frame: the
following as a whole, and where it ends early also later fits, the evidence of streaks and the noise of the
image. *Looks* is the time of the search for squares in a searched frame. Both bound the speed of the same
measurements: OpenCV's time over them is the largest ratio that work on the rest can reach.
"""

import argparse

import numpy as np
from image_cost import DICTIONARY, NOISE, WARM_UP, Scene, timed_ms
from photograph_stages import Stages, Stopwatch

from skyherd.jobs.helpers import one_thread
from skyherd.render import Sensor
from skyherd.vision import PhotometricDetector, create_detector
from skyherd.vision.native.library import Library
from skyherd.vision.photometric import detector as stages

COMPILED = ("follow_markers", "fit_any_blur", "streak_evidence", "second_differences")
"""Functions of the compiled library that a followed frame calls."""

SEARCHES = ("find_quads", "find_small_quads", "find_faint_quads", "find_crossed_quads")
"""Searches for squares in a searched frame."""

STAGES: Stages = {
    "compiled": [(Library, name) for name in COMPILED],
    "looks": [(stages, name) for name in SEARCHES],
    "search": [(PhotometricDetector, "_search")],
}
"""Stages that are timed separately: both parts, and the search, which a followed frame lacks."""


def measure(size_px: tuple[int, int], markers: int, noise: float, frames: int) -> dict[str, float]:
    """Return the medians of the times of OpenCV, of followed and searched frames and of their parts, ms."""
    scene = Scene(DICTIONARY, size_px, markers)
    scene.renderer.sensor = Sensor(noise, np.random.default_rng(2))
    names = {"opencv": "opencv", "followed": "tracking", "searched": "photometric", "quick": "quick"}
    detectors = {what: create_detector(name, dictionary=DICTIONARY) for what, name in names.items()}
    rows: dict[str, list[float]] = {what: [] for what in (*names, "compiled", "looks")}
    for frame in range(WARM_UP + frames):
        image = scene.draw(frame)
        for what, detector in detectors.items():
            with Stopwatch(STAGES) as watch:
                _, took_ms = timed_ms(detector.detect, image, time_s=frame / 10)
            if frame < WARM_UP or (what == "followed" and watch.spent_s["search"]):
                continue
            rows[what].append(took_ms)
            part = {"followed": "compiled", "searched": "looks"}.get(what)
            if part:
                rows[part].append(1e3 * watch.spent_s[part])
    return {what: float(np.median(times)) for what, times in rows.items()}


def main() -> None:
    """Measure and print a line for each noise."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 960), help="of the images, px")
    parser.add_argument("--markers", type=int, default=16)
    parser.add_argument("--noise", type=float, nargs="+", default=(0.0, NOISE), help="grey levels")
    parser.add_argument("--frames", type=int, default=60, help="frames that count")
    options = parser.parse_args()
    columns = ("followed", "compiled", "searched", "looks", "quick")
    print(f"| noise | OpenCV, ms | {' | '.join(f'{c}, ms | OpenCV over it' for c in columns)} |")
    print("| --- " * (2 + 2 * len(columns)) + "|")
    with one_thread():
        for noise in options.noise:
            row = measure(tuple(options.size), options.markers, noise, options.frames)
            told = " | ".join(f"{row[c]:.2f} | {row['opencv'] / row[c]:.1f}" for c in columns)
            print(f"| {noise:g} | {row['opencv']:.1f} | {told} |", flush=True)


if __name__ == "__main__":
    main()
