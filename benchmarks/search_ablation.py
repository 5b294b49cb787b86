"""Measure what each search of the photometric detector costs, and which markers it alone finds.

    OPENBLAS_NUM_THREADS=1 python benchmarks/search_ablation.py
    OPENBLAS_NUM_THREADS=1 python benchmarks/search_ablation.py FOLDER benchmarks/photographs.toml

Variants leave out one of the three searches that follow the first one, or all of them. Sources are markers by
themselves and touching ones (`touching.py`), those under odd conditions (`odd_conditions.py`), and the sets
of photographs in the given folders. Cells: markers read with their id; those of photographs are not checked.
The last row is the processor time for photographs over that of OpenCV's default detector.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np
from odd_conditions import CONDITIONS, MARGINS, measure
from touching import CONTRASTS, SIDES_PX, TILTS_DEG, count_right, scenes

from skyherd.bench.image_sets import load_image_sets
from skyherd.geometry import Array, Image
from skyherd.jobs.helpers import one_thread
from skyherd.messages import Detections
from skyherd.vision import create_detector
from skyherd.vision.photometric import detector as stages

SEARCHES = {
    "small": "find_small_quads",
    "faint": "find_faint_quads",
    "crossed": "find_crossed_quads",
}
"""Searches after the first one, by name: functions of the detector's module."""

VARIANTS = {
    "all": (),
    **{f"without {name}": (name,) for name in SEARCHES},
    "the first alone": tuple(SEARCHES),
}
"""Searches that a variant leaves out."""

DICTIONARIES = "4X4_50", "APRILTAG_36h11"


@contextmanager
def without(searches: tuple[str, ...]) -> Iterator[None]:
    """Leave out searches in the body."""

    def none(*given: object) -> Array:
        return np.zeros((0, 4, 2))

    with ExitStack() as stack:
        for name in searches:
            stack.enter_context(patch.object(stages, SEARCHES[name], none))
        yield


class Variant:
    """The photometric detector without some searches, for single images."""

    def __init__(self, searches: tuple[str, ...], **options: Any) -> None:
        self.searches, self.detector = searches, create_detector("photometric", **options)

    def detect(self, image: Image) -> Detections:
        """Return the markers in an image."""
        with without(self.searches):
            return self.detector.detect(image)


def boards(dictionary: str) -> Counter[str]:
    """Return the markers of boards that each variant reads, and all of them."""
    detectors = {name: Variant(left_out, dictionary=dictionary) for name, left_out in VARIANTS.items()}
    found: Counter[str] = Counter()
    for scene in scenes(dictionary, SIDES_PX, TILTS_DEG, CONTRASTS, tuning=False):
        found["markers"] += len(scene.centers_px)
        found.update(
            {name: count_right(one.detect(scene.image), scene)[0] for name, one in detectors.items()}
        )
    return found


def odd(dictionary: str) -> Counter[str]:
    """Return the markers under odd conditions that each variant reads, and all of them."""
    detectors = {name: Variant(left_out, dictionary=dictionary) for name, left_out in VARIANTS.items()}
    found: Counter[str] = Counter()
    for condition in (*CONDITIONS, *MARGINS):
        row = measure(condition, dictionary, detectors, tuning=False)
        found["markers"] += row["markers"]
        found.update({name: row[name]["found"] for name in detectors})
    return found


def photographs(folder: Path, sets: Path) -> tuple[Counter[str], Counter[str]]:
    """Return the markers that each variant reads, and the processor times of variants and OpenCV, s."""
    found: Counter[str] = Counter()
    times_s: Counter[str] = Counter()
    for image_set in load_image_sets(folder, sets):
        options = {"dictionary": image_set.dictionary, **image_set.marker_options()}
        repeats = image_set.model.ids_repeat
        detectors: dict[str, Any] = {
            name: Variant(left_out, repeats=repeats, **options) for name, left_out in VARIANTS.items()
        }
        detectors["OpenCV"] = create_detector("opencv", **options)
        for _, image in image_set.images():
            for name, detector in detectors.items():
                began_s = process_time()
                found[name] += len(detector.detect(image))
                times_s[name] += process_time() - began_s
    return found, times_s


def row_of(name: str, cells: list[str]) -> None:
    """Print a row of the table."""
    print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    """Measure, and print a row for each source."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "folders", nargs="*", type=Path, help="a folder of photographs, then its sets, and so on"
    )
    given = parser.parse_args().folders
    row_of("markers", ["of", *VARIANTS])
    row_of("---", ["---"] * (1 + len(VARIANTS)))
    with one_thread():
        for kind, source in (("boards", boards), ("odd conditions", odd)):
            for dictionary in DICTIONARIES:
                found = source(dictionary)
                row_of(f"{kind}, {dictionary}", [str(found[name]) for name in ("markers", *VARIANTS)])
        found, times_s = Counter[str](), Counter[str]()
        for folder, sets in zip(given[::2], given[1::2], strict=True):
            for total, one in zip((found, times_s), photographs(folder, sets), strict=True):
                total.update(one)
        if given:
            row_of("photographs", ["", *(str(found[name]) for name in VARIANTS)])
            ratios = (times_s[name] / times_s["OpenCV"] for name in VARIANTS)
            row_of("time over OpenCV's", ["", *(f"{ratio:.2f}" for ratio in ratios)])


if __name__ == "__main__":
    main()
