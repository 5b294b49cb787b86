"""Reproduce the corner errors of `photometric` on rendered images whose cells are drawn without antialiasing.

    python benchmarks/aliased_drawings.py

Some renderers smooth the outline of a textured square and sample its texture at the nearest texel; frame 37
of ICRA 2020 in the tests of locus-tag was drawn so. Each cell then begins at a whole pixel, up to half a
pixel off its place, while the outline is right. A fit to all edges of a marker follows the cells; a
detector of the outline alone does not. The table has the median error of corners, px, for both ways of
drawing: by detectors, and by the edges of the outline (`skyherd.vision.search.edges`).
"""

import cv2
import numpy as np
import numpy.typing as npt
from command import run

from skyherd.geometry import Array
from skyherd.markers.dictionary import marker_cells
from skyherd.vision import create_detector
from skyherd.vision.search.edges import fit_edges

DICTIONARY, SIDE_PX, COUNT, SEED = "APRILTAG_36h11", 24.8, 60, 1
NAMES = ("photometric", "opencv", "apriltag3", "locus-tag")
PITCH, COLUMNS, FINE = 44, 10, 8


def drawing(*, aliased: bool) -> tuple[npt.NDArray[np.uint8], Array]:
    """Return an image of markers and their corners (N, 4, 2), clockwise from the upper left."""
    rng = np.random.default_rng(SEED)
    image = np.full((PITCH * (COUNT // COLUMNS), PITCH * COLUMNS), 255.0)
    corners = []
    for marker in range(COUNT):
        at = np.array([marker % COLUMNS, marker // COLUMNS]) * PITCH + 9 + rng.uniform(0, 1, 2)
        cells = np.pad(marker_cells(DICTIONARY, marker), 1, constant_values=True)
        n = len(cells) - 2
        pixels = np.arange(PITCH * FINE).reshape(PITCH, FINE)
        origin = np.floor(at).astype(int) - 8
        places = (pixels + 0.5) / FINE
        low, high = (at - origin)[:, None, None], (at - origin + SIDE_PX)[:, None, None]
        inside = [((places >= a) & (places < b)).mean(axis=1) for a, b in zip(low, high, strict=True)]
        cover = np.outer(inside[1], inside[0])
        if aliased:
            middles = np.arange(PITCH) + 0.5
            index = [
                np.clip(np.floor((middles - a) / SIDE_PX * n).astype(int), 0, n - 1) for a in at - origin
            ]
            white = cells[1:-1, 1:-1][np.ix_(index[1], index[0])].astype(float)
        else:
            fine = [
                np.clip(np.floor((places.ravel() - a) / SIDE_PX * n).astype(int), 0, n - 1)
                for a in at - origin
            ]
            white = cells[1:-1, 1:-1][np.ix_(fine[1], fine[0])].astype(float)
            white = cv2.resize(white, (PITCH, PITCH), interpolation=cv2.INTER_AREA)
        window = image[origin[1] : origin[1] + PITCH, origin[0] : origin[0] + PITCH]
        height, width = window.shape
        window -= (255 * cover * (1 - white))[:height, :width]
        box = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * SIDE_PX
        corners.append(at + box - 0.5)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), np.array(corners)


def nearest_errors(found: Array, truth: Array) -> Array:
    """Return the distances (N, 4) of corners (N, 4, 2) from the nearest true corners, px."""
    distances = np.linalg.norm(found[:, :, None] - truth[:, None], axis=3)
    return np.asarray(distances.min(axis=2))


def main() -> None:
    print("| cells | " + " | ".join((*NAMES, "edges of the outline")) + " |")
    print("|---" * (2 + len(NAMES)) + "|")
    for aliased in (False, True):
        image, truth = drawing(aliased=aliased)
        cells = []
        for name in NAMES:
            seen = create_detector(name, dictionary=DICTIONARY).detect(image)
            known = seen.ids < COUNT
            errors = nearest_errors(seen.corners_px[known], truth[seen.ids[known]])
            cells.append(f"{np.median(errors):.3f} ({np.count_nonzero(known)})")
        outline = fit_edges(image, truth + np.random.default_rng(2).uniform(-0.7, 0.7, truth.shape), 8)
        cells.append(f"{np.median(nearest_errors(outline.corners_px, truth)):.3f}")
        print(f"| {'nearest texel' if aliased else 'antialiased'} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    run(main)
