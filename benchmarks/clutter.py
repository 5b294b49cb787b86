"""Measure false positives of detectors on drawn clutter: shapes that resemble markers and are none.

    python benchmarks/clutter.py --small 30000 --images 2000 --json clutter.json
    python benchmarks/clutter.py --small 0 --images 600 --seed 7 --robust-log-odds 2.7
    python benchmarks/clutter.py --small 0 --markers 4

Small images show one shape each, under perspective, blur, noise and uneven light: a dark square with light
squares in it, a grid of random bits, text in a dark frame, a chessboard, a fence, a picture frame. Images
of 640 x 480 px show twenty of these. A shape whose cells equal a codeword of the dictionary in any quarter
turn is that marker, and is drawn again. The table gives the false positives of each detector and kind, and
the upper end of the 95 % interval of their rate for each shape (Clopper and Pearson, 1934).

The image of a shape may show a marker though its cells do not, as blur joins what is apart. The last lines
say how many false positives show every bit of their id.

With `--markers N`, markers of one size lie among the twenty shapes. A detection is then false if its centre
is more than half a side from the marker with its id.
"""

import argparse
import json
from collections import Counter
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from command import add_thresholds, run
from scipy.stats import beta

from skyherd.files.atomic import write_text
from skyherd.geometry import Array, IntArray
from skyherd.markers.dictionary import all_marker_cells, cells_per_side, dictionary_size, marker_cells
from skyherd.messages import Detections
from skyherd.vision import create_detector

Pattern = npt.NDArray[np.float32]
"""A shape on its ground, (PATTERN_PX, PATTERN_PX), 0 for black to 1 for white."""

PATTERN_PX, SQUARE = 192, slice(32, 160)
"""Side of a pattern, and the rows and columns of the dark square in it."""

SMALL_PX, SIDES_PX = 96, (12.0, 56.0)
"""Side of a small image, and the range of the square's side in it."""

LARGE_PX, SHAPES = (640, 480), 20
"""Size of an image, and the shapes in it."""

CELL_POINTS = 8
"""Points along a cell where the bits of a false positive are read."""

MAX_MARKERS = 8
"""Most markers in an image: one in each of as many columns."""

OVERSAMPLING = 3
LETTERS = "ABCDEFGHJKLMNPQRSTUVWXYZ0123456789#%&@"


def squares(rng: np.random.Generator) -> Pattern:
    """Return a dark square with one to four light rectangles in it."""
    pattern = _ground(rng)
    pattern[SQUARE, SQUARE] = rng.uniform(0.0, 0.2)
    for _ in range(rng.choice([1, 1, 1, 2, 3, 4])):
        low = rng.uniform(40, 120, 2)
        size = rng.uniform(12, 100, 2)
        (y, x), (b, r) = low.astype(int), np.minimum(low + size, 153).astype(int)
        pattern[y:b, x:r] = rng.uniform(0.6, 1.0)
    return pattern


def bits(rng: np.random.Generator) -> Pattern:
    """Return a dark square with a grid of 3 to 8 random bits a side."""
    n, pattern = int(rng.integers(3, 9)), _ground(rng)
    cells = np.zeros((n + 2, n + 2), dtype=np.float32)
    cells[1:-1, 1:-1] = rng.random((n, n)) < rng.uniform(0.2, 0.8)
    pattern[SQUARE, SQUARE] = cv2.resize(cells, (128, 128), interpolation=cv2.INTER_NEAREST)
    return pattern


def text(rng: np.random.Generator) -> Pattern:
    """Return light letters in a dark square, or dark ones in a dark frame."""
    pattern, is_light = _ground(rng), rng.random() < 0.5
    square = np.full((128, 128), 12, dtype=np.uint8)
    if not is_light:
        square[16:112, 16:112] = 240
    for line in range(rng.integers(1, 4)):
        word = "".join(rng.choice(list(LETTERS), rng.integers(1, 4)))
        scale, thick = float(rng.uniform(0.8, 2.5)), int(rng.integers(2, 9))
        place = (int(rng.integers(8, 48)), 50 + 30 * line)
        cv2.putText(square, word, place, cv2.FONT_HERSHEY_SIMPLEX, scale, 240 if is_light else 12, thick)
    pattern[SQUARE, SQUARE] = square.astype(np.float32) / 255
    return pattern


def chessboards(rng: np.random.Generator) -> Pattern:
    """Return a chessboard of 3 to 10 squares a side."""
    n = int(rng.integers(3, 11))
    rows, columns = np.indices((n, n))
    cells = ((rows + columns + rng.integers(2)) % 2).astype(np.float32)
    pattern = _ground(rng)
    pattern[SQUARE, SQUARE] = cv2.resize(cells, (128, 128), interpolation=cv2.INTER_NEAREST)
    return pattern


def fences(rng: np.random.Generator) -> Pattern:
    """Return bars in one or two directions, of random widths and gaps."""
    pattern = np.full((PATTERN_PX, PATTERN_PX), rng.uniform(0.7, 1.0), dtype=np.float32)
    for axis in range(rng.integers(1, 3)):
        at = float(rng.uniform(0, 20))
        gap, width = rng.uniform(12, 60), rng.uniform(5, 24)
        while at < PATTERN_PX:
            bar = slice(int(at), int(at + width))
            pattern[(bar, slice(None)) if axis else (slice(None), bar)] = rng.uniform(0.0, 0.2)
            at += (gap + width) * rng.uniform(0.8, 1.2)
    return pattern


def frames(rng: np.random.Generator) -> Pattern:
    """Return a dark frame around a picture of blotches."""
    pattern = _ground(rng)
    pattern[SQUARE, SQUARE] = rng.uniform(0.0, 0.15)
    width, n = int(rng.integers(6, 32)), int(rng.integers(3, 14))
    picture = rng.random((n, n)).astype(np.float32)
    side = 128 - 2 * width
    inner = slice(32 + width, 160 - width)
    smooth = cv2.resize(
        picture, (side, side), interpolation=int(rng.choice([cv2.INTER_LINEAR, cv2.INTER_NEAREST]))
    )
    pattern[inner, inner] = np.clip((smooth - 0.5) * rng.uniform(0.5, 3.0) + 0.5, 0, 1)
    return pattern


KINDS: dict[str, Callable[[np.random.Generator], Pattern]] = {
    "squares": squares,
    "random bits": bits,
    "text": text,
    "chessboards": chessboards,
    "fences": fences,
    "picture frames": frames,
}


def _ground(rng: np.random.Generator) -> Pattern:
    pattern = np.full((PATTERN_PX, PATTERN_PX), rng.uniform(0.6, 1.0), dtype=np.float32)
    width = int(rng.choice([32, 32, 32, 16, 8]))
    if width < 32:
        around = np.full_like(pattern, rng.uniform(0.1, 0.9))
        around[32 - width : 160 + width, 32 - width : 160 + width] = pattern[0, 0]
        return around
    return pattern


@lru_cache(maxsize=8)
def _codewords(dictionary: str) -> frozenset[bytes]:
    return frozenset(
        np.rot90(one, turn).tobytes() for one in all_marker_cells(dictionary) for turn in range(4)
    )


def is_codeword(pattern: Pattern, dictionary: str) -> bool:
    """Return whether the cells of a pattern's square are those of a marker, in any quarter turn."""
    n = cells_per_side(dictionary)
    means = cv2.resize(pattern[SQUARE, SQUARE], (n, n), interpolation=cv2.INTER_AREA)
    cells = means > (means.min() + means.max()) / 2
    return cells.tobytes() in _codewords(dictionary)


def drawn(rng: np.random.Generator, dictionary: str, kind: str) -> Pattern:
    """Return a pattern of a kind that is no marker of the dictionary."""
    while is_codeword(pattern := KINDS[kind](rng), dictionary):
        pass
    return pattern


def placed(
    image: Array,
    pattern: Pattern,
    side_px: float,
    center_px: Array,
    rng: np.random.Generator,
    max_tilt_deg: float = 60.0,
) -> Array:
    """Return the image (height, width) of whiteness with a pattern under a random perspective."""
    turn, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(0, np.radians(max_tilt_deg))
    axis, corners = rng.uniform(0, 2 * np.pi), np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2.0
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    along = np.array([np.cos(axis), np.sin(axis)])
    points = corners @ rotation.T * (PATTERN_PX / 128)
    depth = points @ along
    points = points - np.outer(depth * (1 - np.cos(tilt)), along)
    points /= (1 + rng.uniform(0.0, 0.3) * np.sin(tilt) * depth)[:, None]
    target = (points * side_px + center_px + 0.5) * OVERSAMPLING - 0.5
    source = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32) * PATTERN_PX - 0.5
    homography = cv2.getPerspectiveTransform(source, target.astype(np.float32))
    size = (image.shape[1], image.shape[0])
    shrunk = pattern
    while side_px * OVERSAMPLING < 0.5 * (128 * shrunk.shape[0] / PATTERN_PX):
        factor = shrunk.shape[0]
        shrunk = cv2.resize(shrunk, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        homography = homography @ np.diag([2.0, 2.0, 1.0]) @ np.array([[1, 0, 0.25], [0, 1, 0.25], [0, 0, 1]])
        assert shrunk.shape[0] * 2 == factor
    cv2.warpPerspective(shrunk, homography, size, image, cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT)
    return image


def developed(fine: Array, rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Return an image of 8 bits of a fine image of whiteness: blurred, lit unevenly and noisy."""
    height, width = fine.shape[0] // OVERSAMPLING, fine.shape[1] // OVERSAMPLING
    image = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.2, 1.2))
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    light = 1 + rng.uniform(-0.3, 0.3) * x + rng.uniform(-0.3, 0.3) * y
    black, contrast = rng.uniform(5, 60), rng.uniform(40, 180)
    levels = black + contrast * image * light + rng.normal(0, rng.choice([0.5, 1, 2, 4, 8]), image.shape)
    return np.asarray(np.clip(np.rint(levels), 0, 255), dtype=np.uint8)


def small_image(seed: int, number: int, dictionary: str) -> tuple[str, npt.NDArray[np.uint8]]:
    """Return the kind and the small image of a number."""
    rng = np.random.default_rng([seed, number])
    kind = list(KINDS)[number % len(KINDS)]
    fine = np.full((SMALL_PX * OVERSAMPLING,) * 2, rng.uniform(0.3, 1.0), dtype=np.float32)
    center = np.full(2, SMALL_PX / 2 - 0.5) + rng.uniform(-2, 2, 2)
    placed(fine, drawn(rng, dictionary, kind), rng.uniform(*SIDES_PX), center, rng)
    return kind, developed(fine, rng)


def marker_pattern(dictionary: str, marker: int) -> Pattern:
    """Return a marker on white."""
    pattern = np.ones((PATTERN_PX, PATTERN_PX), dtype=np.float32)
    cells = marker_cells(dictionary, marker).astype(np.float32)
    pattern[SQUARE, SQUARE] = cv2.resize(cells, (128, 128), interpolation=cv2.INTER_NEAREST)
    return pattern


def large_image(
    seed: int, number: int, dictionary: str, markers: int = 0
) -> tuple[npt.NDArray[np.uint8], dict[int, Array], float]:
    """Return an image with twenty shapes and markers, the markers' centres by id, px, and their side, px."""
    rng = np.random.default_rng([seed, 1_000_000 + number])
    width, height = LARGE_PX
    fine = np.full((height * OVERSAMPLING, width * OVERSAMPLING), rng.uniform(0.3, 1.0), dtype=np.float32)
    for kind in rng.choice(list(KINDS), SHAPES):
        center = rng.uniform([20, 20], [width - 20, height - 20])
        placed(fine, drawn(rng, dictionary, str(kind)), rng.uniform(*SIDES_PX), center, rng)
    rng_markers = np.random.default_rng([seed, 2_000_000 + number])
    side_px, centers_px = float(rng_markers.uniform(*SIDES_PX)), dict[int, Array]()
    columns = rng_markers.permutation(MAX_MARKERS)[:markers]
    ids = rng_markers.permutation(dictionary_size(dictionary))[:markers].tolist()
    for marker, column in zip(ids, columns, strict=True):
        row = rng_markers.uniform(50, height - 50)
        centers_px[marker] = np.array([(column + 0.5) * width / MAX_MARKERS, row])
        placed(fine, marker_pattern(dictionary, marker), side_px, centers_px[marker], rng_markers)
    return developed(fine, rng), centers_px, side_px


def false_positives(found: Detections, centers_px: dict[int, Array], side_px: float) -> IntArray:
    """Return the rows (K,) of the detections that are more than half a side from the marker with their id."""
    away_px = [
        np.linalg.norm(center - centers_px[marker]) if marker in centers_px else np.inf
        for marker, center in zip(found.ids.tolist(), found.centers_px, strict=True)
    ]
    return np.flatnonzero(np.array(away_px) > side_px / 2)


def count_with_all_bits(
    image: npt.NDArray[np.uint8], found: Detections, rows: IntArray, dictionary: str
) -> int:
    """Return the number of detections, of those at rows (K,), whose marker is in the image bit by bit.

    Every white cell of the marker is then brighter than every black one, each by the mean over its middle.
    """
    n, count = cells_per_side(dictionary), 0
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32) * n * CELL_POINTS - 0.5
    for marker, corners_px in zip(found.ids[rows].tolist(), found.corners_px[rows], strict=True):
        to_cells = cv2.getPerspectiveTransform(corners_px.astype(np.float32), square)
        points = cv2.warpPerspective(image, to_cells, (n * CELL_POINTS,) * 2).astype(float)
        middle = slice(CELL_POINTS // 4, CELL_POINTS - CELL_POINTS // 4)
        means = points.reshape(n, CELL_POINTS, n, CELL_POINTS)[:, middle, :, middle].mean(axis=(1, 3))
        white = marker_cells(dictionary, marker)
        count += bool(means[white].min() > means[~white].max())
    return count


def upper_bound(hits: int, trials: int) -> float:
    """Return the upper end of the two-sided 95 % interval of a rate (Clopper and Pearson, 1934)."""
    return float(beta.ppf(0.975, hits + 1, max(trials - hits, 1)))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--small", type=int, default=30000)
    parser.add_argument("--images", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--dictionary", default="4X4_50")
    parser.add_argument("--detectors", default="photometric,opencv")
    numbers = range(MAX_MARKERS + 1)
    parser.add_argument("--markers", type=int, default=0, choices=numbers, help="markers in each image")
    parser.add_argument("--json", type=Path)
    add_thresholds(parser)
    given = parser.parse_args()
    names = given.detectors.split(",")
    detectors = {name: create_detector(name, dictionary=given.dictionary) for name in names}
    hits: dict[str, Counter[str]] = {name: Counter() for name in names}
    shapes: Counter[str] = Counter()
    found, shown = Counter[str](), Counter[str]()
    for number in range(given.small):
        kind, image = small_image(given.seed, number, given.dictionary)
        shapes[kind] += 1
        for name, detector in detectors.items():
            seen = detector.detect(image)
            hits[name][kind] += len(seen)
            shown[name] += count_with_all_bits(image, seen, np.arange(len(seen)), given.dictionary)
    for number in range(given.images):
        image, centers_px, side_px = large_image(given.seed, number, given.dictionary, given.markers)
        shapes["images of 20"] += 1
        for name, detector in detectors.items():
            seen = detector.detect(image)
            false = false_positives(seen, centers_px, side_px)
            hits[name]["images of 20"] += len(false)
            shown[name] += count_with_all_bits(image, seen, false, given.dictionary)
            found[name] += len(seen) - len(false)
    print(f"| {given.dictionary} | shapes | " + " | ".join(names) + " |")
    print("|---" * (2 + len(names)) + "|")
    for kind, count in shapes.items():
        print(f"| {kind} | {count} | " + " | ".join(str(hits[name][kind]) for name in names) + " |")
    if given.markers:
        right = " | ".join(str(found[name]) for name in names)
        print(f"| markers found | {given.markers * given.images} | {right} |")
    for name in names:
        total = sum(hits[name][kind] for kind in KINDS)
        if given.small:
            bound = upper_bound(total, given.small)
            print(f"{name}: {total} of {given.small} small images, at most {bound:.2e} of them (95 %)")
        print(f"{name}: {shown[name]} of {hits[name].total()} false positives show every bit of their id")
    if given.json:
        write_text(
            given.json, json.dumps({"shapes": shapes, "hits": hits, "given": vars(given)}, default=str)
        )


if __name__ == "__main__":
    run(main)
