"""Measure recall over size, tilt and contrast, for markers by themselves and for ones that touch.

    python benchmarks/touching.py --table touching.md
    python benchmarks/touching.py --tuning --dictionary 4X4_50 --sides 14,40 --tilts 15,50,65

Thirty-six markers lie on a plane: apart by a cell and more, or as the black squares of a chessboard, which
touch at their corners. Cells: markers that each detector reads with their id. `--tuning` takes other seeds.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from command import numbers, run

from skyherd.files.atomic import write_text
from skyherd.geometry import Array, Image, apply_homography, inverse
from skyherd.markers.dictionary import marker_cells
from skyherd.messages import Detections
from skyherd.render import Camera, CameraPose
from skyherd.render.camera.camera import homography_image_ground
from skyherd.vision import create_detector

OVERSAMPLING, CELL_PX = 4, 16
SIDES_PX, TILTS_DEG, CONTRASTS = (12, 14, 20, 30, 40), (0, 15, 30, 50, 65), (1.0, 0.2, 0.05)
ROWS, COLUMNS = 6, 12
NOISE, BLUR_PX = 1.5, 0.5


def board(dictionary: str, *, touching: bool) -> tuple[npt.NDArray[np.float32], Array, float]:
    """Return a board of whiteness, the centres (36, 2) of its markers and their side, px of the board."""
    n = len(marker_cells(dictionary, 0))
    side = n * CELL_PX
    places = [(r, c) for r in range(ROWS) for c in range(COLUMNS) if (r + c) % 2 == 0]
    pitch = side if touching else side + CELL_PX
    image = np.ones(((ROWS + 2) * pitch, (COLUMNS + 2) * pitch), dtype=np.float32)
    centers = []
    for marker, (row, column) in enumerate(places):
        cells = marker_cells(dictionary, marker).astype(np.float32)
        y, x = (row + 1) * pitch, (column + 1) * pitch
        image[y : y + side, x : x + side] = np.kron(cells, np.ones((CELL_PX, CELL_PX), dtype=np.float32))
        centers.append((x + side / 2 - 0.5, y + side / 2 - 0.5))
    return image, np.array(centers), float(side)


def view(
    image: npt.NDArray[np.float32], side: float, side_px: float, tilt_deg: float, rng: np.random.Generator
) -> tuple[npt.NDArray[np.float32], Array]:
    """Return whiteness seen by a tilted camera, and the homography from the board to its pixels."""
    scale = side_px / side
    size = int(1.1 * scale * np.hypot(*image.shape))
    camera = Camera((size, size), focal_px=3.0 * side_px * COLUMNS)
    tilt_rad = np.radians(tilt_deg)  # the distance along the optical axis is the same at any tilt
    height_m = camera.focal_px * np.cos(tilt_rad)
    pose = CameraPose((0.0, 0.0), height_m, rng.uniform(-np.pi, np.pi), (tilt_rad, 0.0))
    to_image = homography_image_ground(camera, pose)
    middle = apply_homography(inverse(to_image), np.full(2, (size - 1) / 2))
    height, width = image.shape
    to_ground = np.array(
        [
            [scale, 0, middle[0] - scale * (width - 1) / 2],
            [0, -scale, middle[1] + scale * (height - 1) / 2],
            [0, 0, 1],
        ]
    )
    homography = to_image @ to_ground
    shrunk, back = image, np.eye(3)
    while scale * OVERSAMPLING * width / shrunk.shape[1] < 0.5:
        shrunk = cv2.resize(shrunk, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        back = back @ np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1.0]])
    fine = np.array([[OVERSAMPLING, 0, 1.5], [0, OVERSAMPLING, 1.5], [0, 0, 1]])
    big = (size * OVERSAMPLING,) * 2
    drawn = cv2.warpPerspective(
        shrunk, fine @ homography @ back, big, flags=cv2.INTER_LINEAR, borderValue=1.0
    )
    return cv2.resize(drawn, (size, size), interpolation=cv2.INTER_AREA), homography


@dataclass(frozen=True)
class Scene:
    """Image of a board.

    Attributes:
        kind: `apart` or `touch`.
        side_px: side of the markers where the board is level.
        tilt_deg: of the camera.
        contrast: of the print, 1 for black on white.
        image: grey, (height, width).
        centers_px: (36, 2) of the markers, in the order of their ids.
    """

    kind: str
    side_px: float
    tilt_deg: float
    contrast: float
    image: Image
    centers_px: Array


def scenes(
    dictionary: str,
    sides_px: Sequence[float],
    tilts_deg: Sequence[float],
    contrasts: Sequence[float],
    *,
    tuning: bool,
) -> Iterator[Scene]:
    """Yield an image of each combination, of markers by themselves and then of ones that touch."""
    for touching in (False, True):
        whiteness, centers, side = board(dictionary, touching=touching)
        for side_px, tilt_deg, contrast in product(sides_px, tilts_deg, contrasts):
            rng = np.random.default_rng([tuning, touching, int(side_px), int(tilt_deg), int(100 * contrast)])
            white, homography = view(whiteness, side, side_px, tilt_deg, rng)
            white = cv2.GaussianBlur(white, (0, 0), BLUR_PX)
            levels = 110 + contrast * 170 * (white - 0.5) + rng.normal(0, NOISE, white.shape)
            shown = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
            kind, truth_px = "touch" if touching else "apart", apply_homography(homography, centers)
            yield Scene(kind, side_px, tilt_deg, contrast, shown, truth_px)


def count_right(found: Detections, scene: Scene) -> tuple[int, int]:
    """Return how many markers of a scene were read with their id, and how many detections are wrong."""
    truth_px, places = scene.centers_px, zip(found.ids.tolist(), found.centers_px, strict=True)
    right = sum(
        marker < len(truth_px) and np.linalg.norm(center_px - truth_px[marker]) < 0.3 * scene.side_px
        for marker, center_px in places
    )
    return right, len(found) - right


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--dictionary", default="APRILTAG_36h11")
    parser.add_argument("--detectors", default="photometric,opencv,apriltag3,locus-tag")
    parser.add_argument("--sides", type=numbers, default=SIDES_PX)
    parser.add_argument("--tilts", type=numbers, default=TILTS_DEG)
    parser.add_argument("--contrasts", type=numbers, default=CONTRASTS)
    parser.add_argument("--tuning", action="store_true")
    parser.add_argument("--table", type=Path)
    given = parser.parse_args()
    names = given.detectors.split(",")
    detectors = {name: create_detector(name, dictionary=given.dictionary) for name in names}
    lines = [
        f"| {given.dictionary}: squares | side, px | tilt, deg | contrast | "
        + " | ".join(names)
        + " | wrong |",
        "|---" * (5 + len(names)) + "|",
    ]
    print("\n".join(lines))
    for scene in scenes(given.dictionary, given.sides, given.tilts, given.contrasts, tuning=given.tuning):
        counts = [count_right(detector.detect(scene.image), scene) for detector in detectors.values()]
        found, wrong = zip(*counts, strict=True)
        cells = [f"{scene.side_px:g}", f"{scene.tilt_deg:g}", f"{scene.contrast:g}", *map(str, found)]
        lines.append(f"| {scene.kind} | " + " | ".join(cells) + " | " + ", ".join(map(str, wrong)) + " |")
        print(lines[-1], flush=True)
    if given.table:
        write_text(given.table, "\n".join(lines) + "\n")


if __name__ == "__main__":
    run(main)
