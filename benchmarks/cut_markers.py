"""Measure what detectors make of markers that the image's border cuts: found, and taken for others.

    python benchmarks/cut_markers.py --dictionary 4X4_50 --images 900
    python benchmarks/cut_markers.py --dictionary APRILTAG_16h5 --seed 3

Each image of 320 x 240 px has eight markers of 28 to 60 px about its border, at any angle or upright, whose
centres lie between 0.4 sides outside and 0.45 sides inside. Markers with all bits in the image can be read.
Half of a marker can look like another one that is seen at a slant.
"""

import argparse

import cv2
import numpy as np
import numpy.typing as npt
from command import run

from skyherd.geometry import Array
from skyherd.markers.dictionary import dictionary_size, marker_cells
from skyherd.vision import create_detector

SIZE_PX, SIDES_PX, OUTSIDE, INSIDE = (320, 240), (28.0, 60.0), 0.4, 0.45
OVERSAMPLING, CELL_PX, BLUR_PX, NOISE, NEAR_PX = 4, 8, 0.7, 2.0, 3.0


def draw(dictionary: str, rng: np.random.Generator) -> tuple[npt.NDArray[np.uint8], list[tuple[int, Array]]]:
    """Return an image, and the id and centre, px, of each of its markers."""
    (width, height), zoom = SIZE_PX, OVERSAMPLING
    ground = np.full((height * zoom, width * zoom), rng.uniform(60, 180), dtype=np.float32)
    side_px, markers = rng.uniform(*SIDES_PX), []
    for number, marker in enumerate(rng.integers(0, dictionary_size(dictionary), 8)):
        within, along = rng.uniform(-OUTSIDE, INSIDE) * side_px, 0.25 + 0.5 * (number // 4)
        center = np.array(
            [
                (within, along * height),
                (width - within, along * height),
                (along * width, within),
                (along * width, height - within),
            ][number % 4]
        )
        turn = rng.uniform(-np.pi, np.pi) if rng.random() < 0.5 else rng.integers(4) * np.pi / 2
        cells = np.pad(marker_cells(dictionary, int(marker)).astype(np.float32), 1, constant_values=1.0)
        card = 20 + 220 * np.kron(cells, np.ones((CELL_PX, CELL_PX), dtype=np.float32))
        scale = zoom * side_px / ((len(cells) - 2) * CELL_PX)
        to_image = np.empty((2, 3))
        to_image[:, :2] = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        to_image[:, 2] = zoom * (center + 0.5) - 0.5 - to_image[:, :2] @ np.full(2, (len(card) - 1) / 2)
        how = {"flags": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_TRANSPARENT}
        cv2.warpAffine(card, to_image, (width * zoom, height * zoom), dst=ground, **how)
        markers.append((int(marker), center))
    image = cv2.GaussianBlur(cv2.resize(ground, SIZE_PX, interpolation=cv2.INTER_AREA), (0, 0), BLUR_PX)
    return np.clip(np.rint(image + rng.normal(0, NOISE, image.shape)), 0, 255).astype(np.uint8), markers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dictionary", default="4X4_50")
    parser.add_argument("--detectors", default="photometric,opencv")
    parser.add_argument("--images", type=int, default=900)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    names = given.detectors.split(",")
    detectors = {name: create_detector(name, dictionary=given.dictionary) for name in names}
    found, false = dict.fromkeys(names, 0), dict.fromkeys(names, 0)
    rng = np.random.default_rng(given.seed)
    for number in range(given.images):
        image, markers = draw(given.dictionary, rng)
        for name, detector in detectors.items():
            seen = detector.detect(image, unit_id=number)
            for marker, center in zip(seen.ids.tolist(), seen.centers_px, strict=True):
                offsets_px = [np.linalg.norm(center - place) for own, place in markers if own == marker]
                is_right = min(offsets_px, default=np.inf) < NEAR_PX
                found[name] += is_right
                false[name] += not is_right
    print(f"| {given.dictionary}: {8 * given.images} markers | found | false |\n|---|---|---|")
    for name in names:
        print(f"| {name} | {found[name]} | {false[name]} |")


if __name__ == "__main__":
    run(main)
