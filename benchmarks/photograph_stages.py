"""Profile the detector on photographs: finding quadrilaterals, and fitting markers.

    python benchmarks/photograph_stages.py FOLDER --sets benchmarks/photographs.toml

Times are of one thread, relative to OpenCV's default detector on the same image, and medians over a set's
images. Each image is the first that its detector sees. The search alone bounds the speed of a detector with
these two searches. Both searches and the fits run in compiled code.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from skyherd.bench.image_sets import ImageSet, load_image_sets
from skyherd.jobs.helpers import one_thread
from skyherd.vision import create_detector
from skyherd.vision.native.library import Library
from skyherd.vision.photometric import detector as stages

Stages = Mapping[str, Sequence[tuple[Any, str]]]
"""Functions whose time counts as that of a stage, by the stage's name: where each is found, and its name
there."""

STAGES: Stages = {
    "first search": [(stages, "find_quads")],
    "second search": [
        (stages, name) for name in ("find_small_quads", "find_faint_quads", "find_crossed_quads")
    ],
    "fits": [(Library, "fit_any_blur")],
}
"""Stages that are timed separately."""


class Stopwatch:
    """Adds up the time spent in stages, `spent_s`, while it is entered, by replacing their functions."""

    def __init__(self, stages: Stages) -> None:
        self.spent_s: Counter[str] = Counter()
        self._places = [
            (stage, owner, name, getattr(owner, name))
            for stage, places in stages.items()
            for owner, name in places
        ]

    def __enter__(self) -> "Stopwatch":
        for stage, owner, name, original in self._places:
            setattr(owner, name, self._timed(stage, original))
        return self

    def __exit__(self, *exception: object) -> None:
        for _, owner, name, original in self._places:
            setattr(owner, name, original)

    def _timed(self, stage: str, original: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*given: Any, **options: Any) -> Any:
            began_s = perf_counter()
            result = original(*given, **options)
            self.spent_s[stage] += perf_counter() - began_s
            return result

        return timed


def measure(image_set: ImageSet) -> dict[str, float]:
    """Return OpenCV's time for a set's image, ms, and each stage's over it, in the median of all images."""
    options = image_set.marker_options()
    peer = create_detector("opencv", dictionary=image_set.dictionary, **options)
    repeats = image_set.model.ids_repeat
    ours = create_detector("photometric", dictionary=image_set.dictionary, repeats=repeats, **options)
    rows = []
    for number, (_, image) in enumerate(image_set.images()):
        times_s = []
        for detector in (peer, ours):
            with Stopwatch(STAGES) as watch:
                began_s = perf_counter()
                detector.detect(image, unit_id=number)
                times_s.append(perf_counter() - began_s)
        rows.append([times_s[1], *(watch.spent_s[stage] for stage in STAGES), times_s[0]])
    rows = rows[1:] or rows  # the first image loads what is made once
    *shares, peer_s = np.array(rows).T
    medians = {
        name: float(np.median(part / peer_s)) for name, part in zip(("all", *STAGES), shares, strict=True)
    }
    return {"opencv_ms": 1e3 * float(np.median(peer_s)), **medians}


def main() -> None:
    """Measure and print a line for each set."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sets", type=Path)
    parser.add_argument("--only", nargs="*", default=())
    options = parser.parse_args()
    columns = ("all", *STAGES)
    print(f"| images | OpenCV, ms | {' | '.join(columns)} |\n" + "| --- " * (2 + len(columns)) + "|")
    with one_thread():
        for image_set in load_image_sets(options.folder, options.sets, only=tuple(options.only)):
            row = measure(image_set)
            told = " | ".join(f"{row[name]:.1f}" for name in columns)
            print(f"| {image_set.name} | {row['opencv_ms']:.0f} | {told} |", flush=True)


if __name__ == "__main__":
    main()
