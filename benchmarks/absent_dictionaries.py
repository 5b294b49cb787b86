"""Count what detectors report of dictionaries that the photographs do not show.

    python benchmarks/absent_dictionaries.py FOLDER --sets benchmarks/photographs.toml

Each image is read with every dictionary of `DICTIONARIES` whose codes have another size than those of its
set, with the set's border and colours. Each marker that is found is a false positive, unless the scene has
other markers besides. The last column has the upper end of the 95 % interval of the rate for each reading
(Clopper and Pearson, 1934).
"""

import argparse
from collections import Counter
from pathlib import Path

from clutter import upper_bound
from command import run

from skyherd.bench.image_sets import load_image_sets
from skyherd.markers.dictionary import cells_per_side
from skyherd.vision import create_detector

DICTIONARIES = (
    *("4X4_50", "4X4_1000", "APRILTAG_16h5"),
    *("5X5_1000", "APRILTAG_36h11", "6X6_1000", "7X7_1000"),
)
"""Of each size of code, 16 to 49 bits, dictionaries in which chance finds the most, and two usual ones."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sets", type=Path, help="file that describes the sets")
    parser.add_argument("--detectors", default="photometric,opencv")
    given = parser.parse_args()
    names = given.detectors.split(",")
    reports, readings, images = Counter[tuple[str, str]](), Counter[str](), Counter[tuple[str, str]]()
    for one in load_image_sets(given.folder, given.sets):
        absent = [name for name in DICTIONARIES if cells_per_side(name) != cells_per_side(one.dictionary)]
        detectors = {
            (name, dictionary): create_detector(name, dictionary=dictionary, **one.marker_options())
            for name in names
            for dictionary in absent
        }
        for file, image in one.images():
            readings.update(absent)
            for (name, dictionary), detector in detectors.items():
                found = detector.detect(image)
                reports[name, dictionary] += len(found)
                images[name, dictionary] += bool(len(found))
                for marker in found:
                    u, v = marker.center_px
                    what = f"id {marker.id} of {dictionary} at ({u:.0f}, {v:.0f})"
                    print(f"{one.name}/{file}: {name} reads {what}")
    print("| dictionary | readings | " + " | ".join(names) + f" | at most, {names[0]} |")
    print("|---" * (3 + len(names)) + "|")
    total = readings.total()
    for dictionary in (*DICTIONARIES, "all"):
        keys = DICTIONARIES if dictionary == "all" else (dictionary,)
        count = total if dictionary == "all" else readings[dictionary]
        found = [sum(reports[name, key] for key in keys) for name in names]
        hits = sum(images[names[0], key] for key in keys)
        cells = [dictionary, count, *found, f"{upper_bound(hits, count):.2%}"]
        print("| " + " | ".join(map(str, cells)) + " |")


if __name__ == "__main__":
    run(main)
