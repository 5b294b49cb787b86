"""Measure recall over size, tilt and contrast, for markers by themselves and for ones that touch.

    python benchmarks/touching.py --table touching.md
    python benchmarks/touching.py --tuning --dictionary 4X4_50 --sides 14,40 --tilts 15,50,65

Thirty-six markers lie on a plane: apart by a cell and more, or as the black squares of a chessboard, which
touch at their corners. Cells: markers that each detector reads with their id. `--tuning` takes other seeds.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.files.atomic import write_text
from skyherd.geometry import Array
from skyherd.markers.dictionary import marker_cells
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
    height, width = image.shape
    scale, tilt, turn = side_px / side, np.radians(tilt_deg), rng.uniform(0, 2 * np.pi)
    focal = 12 * side_px * COLUMNS / 4
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    lean = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    pose = lean @ rotation
    reach = scale * np.hypot(height, width)
    size = int(reach * 1.1)
    intrinsics = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    to_plane = np.array([[scale, 0, -scale * width / 2], [0, scale, -scale * height / 2], [0, 0, 1]])
    homography = intrinsics @ np.column_stack([pose[:, 0], pose[:, 1], [0, 0, focal]]) @ to_plane
    fine = np.array([[OVERSAMPLING, 0, 1.5], [0, OVERSAMPLING, 1.5], [0, 0, 1]])
    small, back = image, np.eye(3)
    while scale * OVERSAMPLING * width / small.shape[1] < 0.5:
        small = cv2.resize(small, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        back = back @ np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1.0]])
    big = (size * OVERSAMPLING,) * 2
    drawn = cv2.warpPerspective(small, fine @ homography @ back, big, flags=cv2.INTER_LINEAR, borderValue=1.0)
    return cv2.resize(drawn, (size, size), interpolation=cv2.INTER_AREA), homography


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--dictionary", default="APRILTAG_36h11")
    parser.add_argument("--detectors", default="photometric,opencv,apriltag3,locus-tag")
    parser.add_argument("--sides", default=",".join(map(str, SIDES_PX)))
    parser.add_argument("--tilts", default=",".join(map(str, TILTS_DEG)))
    parser.add_argument("--contrasts", default=",".join(map(str, CONTRASTS)))
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
    for touching in (False, True):
        image, centers, side = board(given.dictionary, touching=touching)
        for side_px in map(float, given.sides.split(",")):
            for tilt in map(float, given.tilts.split(",")):
                for contrast in map(float, given.contrasts.split(",")):
                    rng = np.random.default_rng(
                        [given.tuning, touching, int(side_px), int(tilt), int(100 * contrast)]
                    )
                    white, homography = view(image, side, side_px, tilt, rng)
                    white = cv2.GaussianBlur(white, (0, 0), BLUR_PX)
                    levels = 110 + contrast * 170 * (white - 0.5) + rng.normal(0, NOISE, white.shape)
                    shown = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
                    seen = np.column_stack([centers, np.ones(len(centers))]) @ homography.T
                    truth = seen[:, :2] / seen[:, 2:]
                    found, wrong = [], []
                    for detector in detectors.values():
                        out = detector.detect(shown)
                        ok = [
                            k < len(truth) and np.linalg.norm(c - truth[k]) < 0.3 * side_px
                            for k, c in zip(out.ids.tolist(), out.centers_px, strict=True)
                        ]
                        found.append(sum(ok))
                        wrong.append(len(ok) - sum(ok))
                    kind = "touch" if touching else "apart"
                    cells = [f"{side_px:g}", f"{tilt:g}", f"{contrast:g}", *map(str, found)]
                    lines.append(
                        f"| {kind} | " + " | ".join(cells) + " | " + ", ".join(map(str, wrong)) + " |"
                    )
                    print(lines[-1], flush=True)
    if given.table:
        write_text(given.table, "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
