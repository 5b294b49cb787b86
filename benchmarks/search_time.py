"""Processor time of the compiled search against its OpenCV and NumPy reference, in alternation.

    python benchmarks/search_time.py [FOLDER ...]

The images are 1280x960 with 30 markers, clean and with noise 5, and the photographs of the given folders.
"""

import argparse
import sys
import time
from pathlib import Path

import cv2
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests" / "helpers"))

import search_reference

from skyherd.vision.search.quads import find_quads

SIZE_PX, MARKERS, REPEATS = (1280, 960), 30, 15


def rendered(noise: float) -> np.ndarray:
    """Return an image of dark squares with light cells on light cards, blurred, with noise."""
    rng = np.random.default_rng(0)
    image = np.full(SIZE_PX[::-1], 150, np.uint8)
    for _ in range(MARKERS):
        middle, turn = rng.uniform(60, np.array(SIZE_PX) - 60), rng.uniform(0, np.pi / 2)
        for side, grey in ((42, 230), (30, 30), (10, 220)):
            box = cv2.boxPoints(((float(middle[0]), float(middle[1])), (side, side), np.degrees(turn)))
            cv2.fillPoly(image, [np.rint(16 * box).astype(np.int32)], grey, cv2.LINE_AA, 4)
    noisy = cv2.GaussianBlur(image, (0, 0), 0.8) + noise * rng.standard_normal(image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def times_ms(image: np.ndarray, repeats: int) -> list[float]:
    """Return the median processor times of the reference and of the compiled search, ms."""
    searches = search_reference.find_quads, find_quads
    times = np.zeros((repeats + 1, len(searches)))
    for row in range(repeats + 1):  # the first one warms up
        for column, search in enumerate(searches):
            begin = time.process_time()
            search(image)
            times[row, column] = 1000 * (time.process_time() - begin)
    return np.median(times[1:], axis=0).tolist()


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the search for quadrilaterals.")
    parser.add_argument("folders", nargs="*", type=Path, help="folders of photographs")
    cv2.setNumThreads(1)
    print(f"{'images':40} {'reference ms':>13} {'compiled ms':>12} {'ratio':>6}")
    rows = [(f"1280x960, noise {noise:g}", [times_ms(rendered(noise), REPEATS)]) for noise in (0.0, 5.0)]
    for folder in parser.parse_args().folders:
        images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(folder.iterdir())]
        rows.append((f"{folder.name}, mean", [times_ms(image, 3) for image in images if image is not None]))
    for name, times in rows:
        before, now = np.mean(times, axis=0)
        print(f"{name:40} {before:13.2f} {now:12.2f} {before / now:6.2f}")


if __name__ == "__main__":
    main()
