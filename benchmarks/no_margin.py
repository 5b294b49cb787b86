"""Measure markers that were cut out along their black border, on grey plates and on grass.

    python benchmarks/no_margin.py
    python benchmarks/no_margin.py --dictionary 4X4_50 --follow

Six images of twelve markers of 24 to 60 px, each on a plane of its own, are drawn with 16 points a pixel,
black 25 and white 225, under a blur of 0.5 px and noise 2. Columns: markers found with their id; medians of
the error of corners and of the absolute error of sides, px; mean NEES of centre and heading, and of the
corners of `measure_outlines`.
"""

import argparse

import cv2
import numpy as np
import numpy.typing as npt
from command import run

from skyherd.geometry import Array
from skyherd.markers.dictionary import cells_per_side, dictionary_size, marker_cells
from skyherd.messages import Detections
from skyherd.vision import PhotometricDetector
from skyherd.vision.photometric.remeasure import measure_outlines

SIZE_PX, FINE, IMAGES, FRAMES = (640, 480), 4, 6, 4
BLACK, WHITE, BLUR_PX, NOISE = 25.0, 225.0, 0.5, 2.0
GROUNDS = {
    "card": WHITE,
    "plate 200": 200.0,
    "plate 150": 150.0,
    "plate 110": 110.0,
    "plate 60": 60.0,
    "grass": None,
}
"""Grey levels around markers; None for grass of mean 110 and standard deviation 25 before the blur."""

SQUARE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
SAME_PLACE_PX = 5.0

Grey = npt.NDArray[np.float32]


def scene(
    dictionary: str, ground: float | None, number: int, frame: int
) -> tuple[npt.NDArray[np.uint8], Array, Array]:
    """Return an image, and the ids (12,) and corners (12, 4, 2), px, of its markers."""
    rng = np.random.default_rng([1, number])
    image = grass(rng) if ground is None else np.full(fine_shape(), ground, np.float32)
    ids, corners = np.sort(rng.permutation(min(dictionary_size(dictionary), 50))[:12]), np.zeros((12, 4, 2))
    for k, marker in enumerate(ids.tolist()):
        side, angle = rng.uniform(24, 60), rng.uniform(-np.pi, np.pi) + 0.03 * frame
        center = np.array([80 + 160 * (k % 4), 80 + 160 * (k // 4)]) + rng.uniform(-15, 15, 2)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        corners[k] = (
            SQUARE * side @ (turn @ np.diag([1, rng.uniform(0.7, 1)])).T
            + center
            + [1.7 * frame, -1.1 * frame]
        )
        draw(image, dictionary, marker, corners[k])
    blurred = cv2.resize(
        cv2.GaussianBlur(image, (0, 0), BLUR_PX * FINE), SIZE_PX, interpolation=cv2.INTER_AREA
    )
    noise = np.random.default_rng([2, number, frame]).normal(0, NOISE, blurred.shape)
    return np.clip(np.rint(blurred + noise), 0, 255).astype(np.uint8), ids, corners


def fine_shape() -> tuple[int, int]:
    return SIZE_PX[1] * FINE, SIZE_PX[0] * FINE


def grass(rng: np.random.Generator) -> Grey:
    """Return ground of blades about a pixel wide, at `FINE` points a pixel."""
    blades = cv2.GaussianBlur(rng.normal(0, 1, fine_shape()).astype(np.float32), (0, 0), 0.8 * FINE)
    return np.asarray(110 + 25 * blades / blades.std(), dtype=np.float32)


def draw(image: Grey, dictionary: str, marker: int, corners: Array) -> None:
    """Draw a marker at corners (4, 2), px, into an image of `FINE` points a pixel."""
    n = cells_per_side(dictionary)
    texture = (
        np.where(marker_cells(dictionary, marker), WHITE, BLACK)
        .repeat(20, 0)
        .repeat(20, 1)
        .astype(np.float32)
    )
    source = ((SQUARE + 0.5) * 20 * n - 0.5).astype(np.float32)
    target = ((corners + 0.5) * FINE - 0.5).astype(np.float32)
    given = cv2.getPerspectiveTransform(source, target), image.shape[::-1]
    shares = cv2.warpPerspective(np.ones_like(texture), *given)
    drawn = cv2.warpPerspective(texture, *given, borderMode=cv2.BORDER_REPLICATE)
    image[...] = shares * drawn + (1 - shares) * image


def nees(errors: Array, covariances: Array) -> list[float]:
    """Return NEES (N,) over degrees of freedom of errors (N, K)."""
    squares = np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])
    return [float(square) for square in squares / errors.shape[1]]


def add_errors(
    row: dict[str, list[float]],
    image: npt.NDArray[np.uint8],
    found: Detections,
    dictionary: str,
    ids: Array,
    corners: Array,
) -> None:
    """Add the errors of markers found at their places to the lists of a row."""
    known = np.isin(found.ids, ids)
    true = corners[np.searchsorted(ids, np.where(known, found.ids, ids[0]))]
    # These maps are affine, so that the mean of the corners is the centre.
    off = found.centers_px - true.mean(axis=1)
    here = known & (np.hypot(*off.T) < SAME_PLACE_PX)
    outlines, covariances = measure_outlines(image, found, dictionary)
    true, off = true[here], off[here]
    ahead = true[:, :2].mean(axis=1) - true.mean(axis=1)
    turned = np.angle(np.exp(1j * (found.headings_rad[here] - np.arctan2(ahead[:, 1], ahead[:, 0]))))
    across, down = true[:, 1] - true[:, 0], true[:, 3] - true[:, 0]
    sides = np.sqrt(np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]))
    row["corners"] += np.sqrt(((found.corners_px[here] - true) ** 2).sum(axis=2).mean(axis=1)).tolist()
    row["sides"] += np.abs(found.sides_px[here] - sides).tolist()
    row["poses"] += nees(np.column_stack([off, turned]), found.covariances[here])
    row["outlines"] += nees((outlines[here] - true).reshape(-1, 8), covariances[here])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--dictionary", default="APRILTAG_36h11")
    parser.add_argument("--follow", action="store_true", help="follow markers over four images of a scene")
    given = parser.parse_args()
    print(
        f"| {given.dictionary} | found | corners, px | sides, px | NEES | NEES of outlines |\n"
        + "|---" * 6
        + "|"
    )
    for name, ground in GROUNDS.items():
        row: dict[str, list[float]] = {key: [] for key in ("corners", "sides", "poses", "outlines")}
        markers = 0
        for number in range(IMAGES):
            detector = PhotometricDetector(given.dictionary, following=given.follow)
            for frame in range(FRAMES if given.follow else 1):
                image, ids, corners = scene(given.dictionary, ground, number, frame)
                found = detector.detect(image, time_s=0.1 * frame)
                if frame or not given.follow:
                    markers += ids.size
                    add_errors(row, image, found, given.dictionary, ids, corners)
        medians = " | ".join(f"{np.median(row[key]):.3f}" for key in ("corners", "sides"))
        means = " | ".join(f"{np.mean(row[key]):.2f}" for key in ("poses", "outlines"))
        print(f"| {name} | {len(row['poses'])} of {markers} | {medians} | {means} |", flush=True)


if __name__ == "__main__":
    run(main)
