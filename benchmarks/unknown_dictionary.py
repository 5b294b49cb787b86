"""Measure how often the dictionary and print of markers in photographs are found, and in which time.

    OPENBLAS_NUM_THREADS=1 python benchmarks/unknown_dictionary.py FOLDER --sets benchmarks/photographs.toml

Of each set the first images in which the default detector finds markers are used. `find_dictionary` is told
the print, and is right if it names a dictionary of the set's series. `suggest` is told another dictionary,
one cell of border and black on white, and is right if its words name the series and every option that
differs. Advice to those who look for the right markers counts as needless. Times are processor times of one
thread, relative to a detection with the right dictionary.
"""

import argparse
import re
from pathlib import Path
from time import process_time

import numpy as np

from skyherd.bench.image_sets import ImageSet, load_image_sets
from skyherd.jobs.helpers import one_thread
from skyherd.markers.dictionary import marker_cells
from skyherd.vision import create_detector, find_dictionary, suggest

OTHER = {True: "5X5_50", False: "7X7_50"}
"""Dictionary that is looked for in vain, by whether the right one has other than 25 bits."""


def same_series(name: str | None, other: str) -> bool:
    """Return whether two dictionaries begin with the same marker."""
    return name is not None and np.array_equal(marker_cells(name, 0), marker_cells(other, 0))


def measure(image_set: ImageSet, most: int) -> tuple[list[int], list[float], list[float]]:
    """Return images used, right answers of both functions, needless advice, and the times of both."""
    options, right = image_set.marker_options(), image_set.dictionary
    detector = create_detector(dictionary=right, repeats=True, **options)
    wrong = OTHER[marker_cells(right, 0).shape[0] != 7]
    counts = np.zeros(4, dtype=int)
    find_ratios, suggest_ratios = list[float](), list[float]()
    for _, image in image_set.images():
        began_s = process_time()
        if not len(detector.detect(image)):
            continue
        single_s = process_time() - began_s
        began_s = process_time()
        found = find_dictionary(image, **options)
        find_ratios.append((process_time() - began_s) / single_s)
        began_s = process_time()
        words = suggest(image, wrong) or ""
        suggest_ratios.append((process_time() - began_s) / single_s)
        name = re.search(r"--dictionary (\S+)", words)
        kind = ("--border-bits" in words) == ("border_bits" in options and options["border_bits"] != 1)
        kind &= ("--inverted" in words) == bool(options.get("inverted"))
        advised = kind and same_series(name and name[1], right)
        needless = suggest(image, right, repeats=True, **options) is not None
        counts += [1, same_series(found, right), advised, needless]
        if counts[0] == most:
            break
    return counts.tolist(), find_ratios, suggest_ratios


def main() -> None:
    """Measure and print a row for each set."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sets", type=Path, required=True)
    parser.add_argument("--images", type=int, default=8, help="images of a set, at most")
    options = parser.parse_args()
    print(
        "| set | images | dictionary found | advice right | advice needless | time of finding | of advice |"
    )
    print("| --- " * 7 + "|")
    with one_thread():
        for image_set in load_image_sets(options.folder, options.sets):
            counts, *ratios = measure(image_set, options.images)
            if counts[0]:
                cells = [*map(str, counts), *(f"{np.median(times):.1f}" for times in ratios)]
                print(f"| {image_set.name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
