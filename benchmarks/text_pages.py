"""Processor time and memory of detectors on pages of text, which have thousands of dark shapes and no marker.

    python benchmarks/text_pages.py
    python benchmarks/text_pages.py --megapixels 12 --dictionaries 5X5_1000

Each page is 4:3, with letters of one size, slightly blurred, with noise 2. Memory is the peak of the process,
which only grows from row to row.
"""

import argparse
import resource
import time

import cv2
import numpy as np
import numpy.typing as npt
from command import run
from PIL import Image, ImageDraw, ImageFont

from skyherd.vision import create_detector

LETTERS = list("abcdefghijklmnopqrstuvwxyz     .,")
PAPER, INK, NOISE, BLUR_PX = 235, 30, 2.0, 0.7


def page(megapixels: float, letter_px: int) -> npt.NDArray[np.uint8]:
    """Return a grey page of text with letters of a size, px."""
    rng = np.random.default_rng(1)
    height = round((megapixels * 1e6 * 3 / 4) ** 0.5)
    width = height * 4 // 3
    image = Image.new("L", (width, height), PAPER)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(letter_px)
    for top in range(letter_px, height - letter_px, round(1.3 * letter_px)):
        draw.text((letter_px, top), "".join(rng.choice(LETTERS, 2 * width // letter_px)), fill=INK, font=font)
    levels = cv2.GaussianBlur(np.asarray(image, dtype=float), (0, 0), BLUR_PX)
    return np.clip(levels + rng.normal(0, NOISE, levels.shape), 0, 255).astype(np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--megapixels", type=float, default=1.0)
    parser.add_argument("--letters", default="10,14,20,32", help="sizes of letters, px, with commas")
    parser.add_argument("--dictionaries", default="4X4_50,4X4_1000,5X5_1000,APRILTAG_36h11")
    parser.add_argument("--detectors", default="photometric,opencv")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    names = given.detectors.split(",")
    print("| letters, px | dictionary | " + " | ".join(f"{name}, s | found" for name in names) + " | GB |")
    print("|---" * (3 + 2 * len(names)) + "|")
    for letter_px in map(int, given.letters.split(",")):
        image = page(given.megapixels, letter_px)
        for dictionary in given.dictionaries.split(","):
            cells = []
            for name in names:
                detector = create_detector(name, dictionary=dictionary)
                begin = time.process_time()
                found = detector.detect(image)
                cells += [f"{time.process_time() - begin:.2f}", str(found.ids.size)]
            peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
            print(f"| {letter_px} | {dictionary} | " + " | ".join(cells) + f" | {peak_gb:.2f} |", flush=True)


if __name__ == "__main__":
    run(main)
