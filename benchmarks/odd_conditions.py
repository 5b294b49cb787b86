"""Measure detectors under odd conditions: glare, salt, interlacing, shadows, curled paper and others.

    python benchmarks/odd_conditions.py --table odd.md --json odd.json
    python benchmarks/odd_conditions.py --tuning --only glare --dictionary 4X4_50 --robust-log-odds 2.7

Each condition is applied to images of twelve markers of 40 px on a plane that is tilted by up to 40 degrees;
its strength is that of the table. `--tuning` takes other seeds and other strengths, for work on the detector:
the table is then no result. Columns: markers found with their id, of all; wrong ids of all detectors; root
mean squares of the errors of centres and of corners of `photometric`, px; the NEES of its centres, of all
markers and of those that are not photometric.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from command import add_thresholds, run

from skyherd.files.atomic import write_text
from skyherd.geometry import Array, apply_homography, inverse
from skyherd.markers.blur_model import total_sigma_px
from skyherd.markers.dictionary import cells_per_side, dictionary_size
from skyherd.messages import Quality
from skyherd.render import Camera, CameraPose, FrameTruth, Ground, Quad, Renderer, Sensor, Shot
from skyherd.render.camera.camera import homography_image_ground
from skyherd.vision import create_detector

SIZE_PX, SIDE_PX, IMAGES = (640, 480), 40.0, 4
FOCAL_PX, MAX_TILT_DEG, BLUR_PX = 800.0, 40.0, 0.6
"""Size of an image and of markers at its centre, images of a condition; focal length, largest tilt, and blur
of the lens."""

COLUMNS, ROWS, GROUND_LEVEL = 4, 3, 128.0
PLATE_CELLS = 3.0
"""Width of the plate around a marker without a margin, cells."""

SAME_PLACE = 0.3
"""Distance of centres of one marker at most, in its sides."""

Grey = npt.NDArray[np.float32]
"""Grey levels of an image, (height, width)."""


def scene(
    dictionary: str, rng: np.random.Generator, margin_cells: float, beyond: float
) -> tuple[Grey, FrameTruth]:
    """Return the grey levels (height, width) of twelve markers, and where they are.

    `beyond` is the grey level beyond margins that are narrower than a cell.
    """
    camera = Camera(SIZE_PX, focal_px=FOCAL_PX)
    tilt_rad, axis_rad = np.radians(rng.uniform(0, MAX_TILT_DEG)), rng.uniform(0, 2 * np.pi)
    tilts_rad = float(tilt_rad * np.cos(axis_rad)), float(tilt_rad * np.sin(axis_rad))
    height_m = FOCAL_PX / SIDE_PX * float(np.prod(np.cos(tilts_rad)))
    pose = CameraPose((0.0, 0.0), height_m, rng.uniform(-np.pi, np.pi), tilts_rad)
    ids = np.sort(rng.permutation(min(dictionary_size(dictionary), 50))[: COLUMNS * ROWS])
    grid = np.stack(np.meshgrid(np.arange(COLUMNS), np.arange(ROWS)), axis=-1).reshape(-1, 2) + 0.5
    seen_px = grid * SIZE_PX / [COLUMNS, ROWS] + rng.uniform(-12, 12, grid.shape)
    places_m = apply_homography(inverse(homography_image_ground(camera, pose)), seen_px)
    headings_rad = rng.uniform(-np.pi, np.pi, len(ids))
    margins = [
        Quad(strip, beyond)
        for place_m, heading_rad in zip(places_m, headings_rad, strict=True)
        for strip in outer_strips(dictionary, place_m, heading_rad, margin_cells)
    ]
    shot = Shot(camera, pose, ids, places_m, headings_rad, occluders=margins)
    ground = Ground(int(rng.integers(1000)), mean=GROUND_LEVEL, sigma_px=total_sigma_px(BLUR_PX))
    renderer = Renderer(dictionary, 1.0, ground, Sensor(0.0, rng), psf_px=BLUR_PX)
    return renderer.render(shot).astype(np.float32), renderer.truth(shot)


def outer_strips(dictionary: str, place_m: Array, heading_rad: float, margin_cells: float) -> list[Array]:
    """Return four strips (4, 2), m, over the white zone of a marker of 1 m beyond a margin in cells."""
    cell_m = 1 / cells_per_side(dictionary)
    low, high = 0.5 + margin_cells * cell_m, 0.5 + PLATE_CELLS * cell_m
    if margin_cells >= 1:
        return []
    strip = np.array([[low, -high], [high, -high], [high, high], [low, high]])
    angles = heading_rad + np.arange(4) * np.pi / 2
    turns = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in angles]
    return [place_m + strip @ turn.T for turn in turns]


def finished(levels: Grey, rng: np.random.Generator, noise: float = 2.0) -> npt.NDArray[np.uint8]:
    """Return the image of 8 bits with noise."""
    return np.asarray(np.clip(np.rint(levels + rng.normal(0, noise, levels.shape)), 0, 255), dtype=np.uint8)


def near_markers(centers: Array, rng: np.random.Generator, reach: float = 0.35) -> Array:
    """Return a random point (N, 2), px, on each marker."""
    return centers + rng.uniform(-reach, reach, centers.shape) * SIDE_PX


def glare(levels: Grey, centers: Array, rng: np.random.Generator, radius: float) -> Grey:
    """Add a saturated spot of a radius, in sides, on each marker."""
    y, x = np.indices(levels.shape)
    for u, v in near_markers(centers, rng):
        levels = levels + 400 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * (radius * SIDE_PX) ** 2))
    return np.minimum(levels, 255.0).astype(np.float32)


def reflected(levels: Grey, centers: Array, rng: np.random.Generator, share: float) -> Grey:
    """Add a lamp's reflection to each marker, a streak 7 px wide, as bright at most as a share of white."""
    y, x = np.indices(levels.shape)
    points, angles = near_markers(centers, rng, 0.3), rng.uniform(0, np.pi, len(centers))
    for (u, v), angle in zip(points, angles, strict=True):
        along = np.cos(angle) * (x - u) + np.sin(angle) * (y - v)
        across = np.cos(angle) * (y - v) - np.sin(angle) * (x - u)
        levels = levels + 255 * share * np.exp(-(along**2) / (2 * 14.0**2) - across**2 / (2 * 3.0**2))
    return np.minimum(levels, 255.0).astype(np.float32)


def banded(levels: Grey, centers: Array, rng: np.random.Generator, share: float) -> Grey:
    """Vary the light by a share with a period of 40 rows, as lamps on a rolling shutter do."""
    waves = np.arange(len(levels))[:, None] * 2 * np.pi / 40 + rng.uniform(0, 2 * np.pi)
    return (levels * (1 + share * np.sin(waves))).astype(np.float32)


def interlaced(levels: Grey, centers: Array, rng: np.random.Generator, shift_px: float) -> Grey:
    """Shift every second row to the right, and the others to the left, by half of so many pixels."""
    moved = [
        cv2.warpAffine(levels, np.float32([[1, 0, sign * shift_px / 2], [0, 1, 0]]), levels.shape[::-1])
        for sign in (-1, 1)
    ]
    moved[0][1::2] = moved[1][1::2]
    return np.asarray(moved[0], dtype=np.float32)


def salt(levels: Grey, centers: Array, rng: np.random.Generator, share: float) -> Grey:
    """Set a share of the pixels to white."""
    return np.where(rng.random(levels.shape) < share, 255.0, levels).astype(np.float32)


def salt_and_pepper(levels: Grey, centers: Array, rng: np.random.Generator, share: float) -> Grey:
    """Set a share of the pixels to white or black."""
    hit, white = rng.random(levels.shape) < share, rng.random(levels.shape) < 0.5
    return np.where(hit, 255.0 * white, levels).astype(np.float32)


def dead_rows(levels: Grey, centers: Array, rng: np.random.Generator, share: float) -> Grey:
    """Set a share of the rows to black."""
    levels = levels.copy()
    levels[rng.random(len(levels)) < share] = 0.0
    return levels


def dead_columns(levels: Grey, centers: Array, rng: np.random.Generator, share: float) -> Grey:
    """Set a share of the columns to white."""
    levels = levels.copy()
    levels[:, rng.random(levels.shape[1]) < share] = 255.0
    return levels


def low_contrast(levels: Grey, centers: Array, rng: np.random.Generator, divisor: float) -> Grey:
    """Divide all differences."""
    return 100.0 + (levels - 100.0) / divisor


def hard_shadow(levels: Grey, centers: Array, rng: np.random.Generator, light: float) -> Grey:
    """Darken one side of a line through each marker to a share of the light."""
    y, x = np.indices(levels.shape)
    owner = np.argmin([(x - u) ** 2 + (y - v) ** 2 for u, v in centers], axis=0)
    angles = rng.uniform(0, 2 * np.pi, len(centers))
    points = near_markers(centers, rng, 0.2)
    along = np.cos(angles)[owner] * (x - points[owner, 0]) + np.sin(angles)[owner] * (y - points[owner, 1])
    return np.where(along > 0, levels * light, levels).astype(np.float32)


def stripes(levels: Grey, centers: Array, rng: np.random.Generator, light: float) -> Grey:
    """Lay the shadow of a blind over the image, with slats of 14 px."""
    y, x = np.indices(levels.shape)
    angle = rng.uniform(0, np.pi)
    wave = np.sin((np.cos(angle) * x + np.sin(angle) * y) * np.pi / 14)
    return (levels * np.where(wave > 0, 1.0, light)).astype(np.float32)


def half_in_shade(levels: Grey, centers: Array, rng: np.random.Generator, light: float) -> Grey:
    """Darken the left half of the image."""
    levels = levels.copy()
    levels[:, : levels.shape[1] // 2] *= light
    return levels


def jpeg(levels: Grey, centers: Array, rng: np.random.Generator, quality: float) -> Grey:
    """Compress and decompress the image."""
    packed = cv2.imencode(".jpg", finished(levels, rng), [cv2.IMWRITE_JPEG_QUALITY, int(quality)])[1]
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), dtype=np.float32)


def vignetting(levels: Grey, centers: Array, rng: np.random.Generator, light: float) -> Grey:
    """Darken the corners to a share of the light."""
    y, x = np.meshgrid(
        np.linspace(-1, 1, levels.shape[0]), np.linspace(-1, 1, levels.shape[1]), indexing="ij"
    )
    return (levels * (1 - (1 - light) * (x**2 + y**2) / 2)).astype(np.float32)


def aberration(levels: Grey, centers: Array, rng: np.random.Generator, shift_px: float) -> Grey:
    """Magnify red and blue by some pixels at the borders, as grey means of three colours."""
    height, width = levels.shape
    parts = []
    for factor in (1 - 2 * shift_px / width, 1.0, 1 + 2 * shift_px / width):
        map_px = np.float32([[factor, 0, width / 2 * (1 - factor)], [0, factor, height / 2 * (1 - factor)]])
        parts.append(cv2.warpAffine(levels, map_px, (width, height), borderMode=cv2.BORDER_REPLICATE))
    return np.mean(parts, axis=0, dtype=np.float32)


def pixelated(levels: Grey, centers: Array, rng: np.random.Generator, factor: float) -> Grey:
    """Replace squares of so many pixels a side by their means."""
    step = int(factor)
    size = levels.shape[1] // step, levels.shape[0] // step
    small = cv2.resize(levels, size, interpolation=cv2.INTER_AREA)
    return np.kron(small, np.ones((step, step), dtype=np.float32))[: levels.shape[0], : levels.shape[1]]


def blurred(levels: Grey, centers: Array, rng: np.random.Generator, sigma_px: float) -> Grey:
    """Blur by a Gaussian."""
    return np.asarray(cv2.GaussianBlur(levels, (0, 0), sigma_px), dtype=np.float32)


def defocused(levels: Grey, centers: Array, rng: np.random.Generator, radius_px: float) -> Grey:
    """Blur by a disc."""
    reach = int(np.ceil(radius_px)) + 1
    y, x = np.indices((2 * reach + 1, 2 * reach + 1)) - reach
    disc = np.clip(radius_px + 0.5 - np.hypot(x, y), 0, 1).astype(np.float32)
    return np.asarray(cv2.filter2D(levels, -1, disc / disc.sum()), dtype=np.float32)


def streaked(levels: Grey, centers: Array, rng: np.random.Generator, length_px: float) -> Grey:
    """Blur along a line of a random direction."""
    angle, kernel = rng.uniform(0, np.pi), np.zeros((31, 31), dtype=np.float32)
    for t in np.linspace(-0.5, 0.5, 101):
        kernel[round(15 + t * length_px * np.sin(angle)), round(15 + t * length_px * np.cos(angle))] += 1
    return np.asarray(cv2.filter2D(levels, -1, kernel / kernel.sum()), dtype=np.float32)


def noisy(levels: Grey, centers: Array, rng: np.random.Generator, std: float) -> Grey:
    """Add noise of a standard deviation in grey levels."""
    return (levels + rng.normal(0, std, levels.shape)).astype(np.float32)


def gamma(levels: Grey, centers: Array, rng: np.random.Generator, exponent: float) -> Grey:
    """Raise the light to a power."""
    return (255 * (np.clip(levels, 0, 255) / 255) ** exponent).astype(np.float32)


def overexposed(levels: Grey, centers: Array, rng: np.random.Generator, factor: float) -> Grey:
    """Multiply the light, and clip it."""
    return np.minimum(levels * factor, 255.0).astype(np.float32)


def underexposed(levels: Grey, centers: Array, rng: np.random.Generator, factor: float) -> Grey:
    """Divide the light."""
    return (levels / factor).astype(np.float32)


def posterized(levels: Grey, centers: Array, rng: np.random.Generator, count: float) -> Grey:
    """Round to so many grey levels."""
    step = 255 / (count - 1)
    return (np.rint(levels / step) * step).astype(np.float32)


def skewed(levels: Grey, centers: Array, rng: np.random.Generator, px: float) -> Grey:
    """Shift rows by a wave, as a rolling shutter on a shaking camera does."""
    y, x = (part.astype(np.float32) for part in np.indices(levels.shape))
    rows = centers[np.argmin(np.abs(np.arange(len(levels))[:, None] - centers[:, 1]), axis=1), 1]
    shift = px * np.sin((y - rows[:, None].astype(np.float32)) * 2 * np.pi / 120).astype(np.float32)
    return np.asarray(cv2.remap(levels, x + shift, y, cv2.INTER_LINEAR), dtype=np.float32)


def curled(levels: Grey, centers: Array, rng: np.random.Generator, px: float) -> Grey:
    """Bend each marker's surroundings, so that its middle line bulges by some pixels."""
    y, x = (part.astype(np.float32) for part in np.indices(levels.shape))
    dx = np.zeros_like(x)
    for u, v in centers:
        r = ((y - v) / (0.7 * SIDE_PX)) ** 2
        inside = (np.abs(x - u) < SIDE_PX * 1.2) & (r < 1)
        dx += np.where(inside, -px * r, 0).astype(np.float32)
    return np.asarray(cv2.remap(levels, x + dx, y, cv2.INTER_LINEAR), dtype=np.float32)


def pen_line(levels: Grey, centers: Array, rng: np.random.Generator, width_px: float) -> Grey:
    """Draw a dark line across each marker."""
    levels = levels.copy()
    for point, angle in zip(
        near_markers(centers, rng, 0.25), rng.uniform(0, np.pi, len(centers)), strict=True
    ):
        away = 0.8 * SIDE_PX * np.array([np.cos(angle), np.sin(angle)])
        ends = [tuple(np.rint(8 * (point + sign * away)).astype(int).tolist()) for sign in (-1, 1)]
        cv2.line(levels, ends[0], ends[1], 40.0, int(width_px), cv2.LINE_8, 3)
    return levels


def worn(levels: Grey, centers: Array, rng: np.random.Generator, share: float) -> Grey:
    """Turn patches of a share of the image to white, as worn ink."""
    coarse = rng.normal(size=(levels.shape[0] // 3, levels.shape[1] // 3)).astype(np.float32)
    field = cv2.resize(coarse, levels.shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.where(field > np.quantile(field, 1 - share), 190.0, levels).astype(np.float32)


def moire(levels: Grey, centers: Array, rng: np.random.Generator, amplitude: float) -> Grey:
    """Add a wave of a period of 3.3 px, as on screens."""
    y, x = np.indices(levels.shape)
    return (levels + amplitude * np.sin(1.9 * x + 0.3 * y)).astype(np.float32)


def fog(levels: Grey, centers: Array, rng: np.random.Generator, share: float) -> Grey:
    """Replace a share of the light by a bright veil that varies."""
    coarse = rng.uniform(170, 230, (6, 8)).astype(np.float32)
    veil = cv2.resize(coarse, levels.shape[::-1], interpolation=cv2.INTER_CUBIC)
    return ((1 - share) * levels + share * veil).astype(np.float32)


def sharpened(levels: Grey, centers: Array, rng: np.random.Generator, amount: float) -> Grey:
    """Sharpen by an unsharp mask of 1.5 px."""
    return (levels + amount * (levels - cv2.GaussianBlur(levels, (0, 0), 1.5))).astype(np.float32)


def ghost(levels: Grey, centers: Array, rng: np.random.Generator, share: float) -> Grey:
    """Mix in the image itself, shifted by 6 px."""
    moved = cv2.warpAffine(levels, np.float32([[1, 0, 6], [0, 1, 3]]), levels.shape[::-1])
    return ((1 - share) * levels + share * moved).astype(np.float32)


def covered(levels: Grey, centers: Array, rng: np.random.Generator, share: float) -> Grey:
    """Cover a share of each marker's area by a grey disc at its edge."""
    levels = levels.copy()
    radius = SIDE_PX * np.sqrt(share / np.pi)
    angles = rng.uniform(0, 2 * np.pi, len(centers))
    away = 0.45 * SIDE_PX * np.column_stack([np.cos(angles), np.sin(angles)])
    for point in np.rint(8 * (centers + away)).astype(int).tolist():
        cv2.circle(levels, point, round(8 * radius), 120.0, cv2.FILLED, cv2.LINE_8, 3)
    return levels


def unchanged(levels: Grey, centers: Array, rng: np.random.Generator, strength: float) -> Grey:
    """Leave the image as it is."""
    return levels


CONDITIONS: dict[str, tuple[Callable[..., Grey], float, float]] = {
    "none": (unchanged, 0.0, 0.0),
    "small glare, radius in sides": (glare, 0.08, 0.07),
    "glare, radius in sides": (glare, 0.13, 0.11),
    "lamp's reflection, share of white": (reflected, 0.55, 0.45),
    "lamp bands, share": (banded, 0.45, 0.35),
    "interlaced, px": (interlaced, 3.0, 2.0),
    "salt, share": (salt, 0.08, 0.06),
    "salt and pepper, share": (salt_and_pepper, 0.08, 0.06),
    "dead rows, share": (dead_rows, 0.05, 0.03),
    "dead columns, share": (dead_columns, 0.05, 0.03),
    "contrast, divided by 5": (low_contrast, 5.0, 6.0),
    "contrast, divided by 20": (low_contrast, 20.0, 15.0),
    "hard shadow edge, light": (hard_shadow, 0.3, 0.4),
    "stripes of shade, light": (stripes, 0.45, 0.55),
    "half in shade, light": (half_in_shade, 0.15, 0.2),
    "JPEG, quality 8": (jpeg, 8.0, 12.0),
    "JPEG, quality 25": (jpeg, 25.0, 35.0),
    "vignetting, light in the corners": (vignetting, 0.2, 0.3),
    "chromatic aberration, px": (aberration, 2.0, 1.5),
    "pixelated, px": (pixelated, 2.0, 2.0),
    "blur, px": (blurred, 2.2, 1.8),
    "strong blur, px": (blurred, 4.0, 3.5),
    "defocus, radius in px": (defocused, 3.5, 3.0),
    "motion blur, px": (streaked, 8.0, 6.0),
    "noise, grey levels": (noisy, 25.0, 20.0),
    "strong noise, grey levels": (noisy, 45.0, 40.0),
    "gamma 0.4": (gamma, 0.4, 0.5),
    "gamma 2.5": (gamma, 2.5, 2.0),
    "overexposed, times": (overexposed, 3.0, 2.5),
    "underexposed, divided by": (underexposed, 8.0, 6.0),
    "posterized, levels": (posterized, 4.0, 5.0),
    "rolling shutter wave, px": (skewed, 2.0, 1.5),
    "curled paper, px": (curled, 4.0, 3.0),
    "pen line, px": (pen_line, 3.0, 2.0),
    "worn ink, share": (worn, 0.08, 0.06),
    "moiré, grey levels": (moire, 40.0, 30.0),
    "fog, share": (fog, 0.85, 0.8),
    "sharpened, times": (sharpened, 2.0, 1.5),
    "ghost, share": (ghost, 0.3, 0.25),
    "covered, share": (covered, 0.05, 0.04),
}
"""Conditions: the change, its strength in the table, and that for tuning."""

MARGINS = {
    "margin of a quarter cell": (0.25, GROUND_LEVEL),
    "margin of half a cell": (0.5, GROUND_LEVEL),
    "no margin, on grey": (0.0, GROUND_LEVEL),
    "no margin, on dark grey": (0.0, 40.0),
}
"""Margins of white cards that are narrower than a cell, in cells, and grey levels beyond them."""


def measure(name: str, dictionary: str, detectors: dict[str, Any], *, tuning: bool) -> dict[str, Any]:
    """Return the row of a condition: markers, and for each detector those found, wrong ids and errors."""
    change, *strengths = CONDITIONS.get(name, (unchanged, 0.0, 0.0))
    strength, margin = strengths[tuning], MARGINS.get(name, (1.0, GROUND_LEVEL))
    row: dict[str, Any] = {"condition": name, "strength": strength, "markers": 0}
    row |= {
        key: {"found": 0, "wrong": 0, "off_px": [], "corners_off_px": [], "nees": [], "plain": []}
        for key in detectors
    }
    for number in range(IMAGES):
        rng = np.random.default_rng([900 if tuning else 100, number, *name.encode()[:8]])
        levels, truth = scene(dictionary, rng, *margin)
        ids, centers = truth.ids, truth.centers_px
        image = finished(change(levels, centers, rng, strength), rng)
        row["markers"] += len(ids)
        for key, detector in detectors.items():
            seen, one = detector.detect(image), row[key]
            for k, marker in enumerate(seen.ids.tolist()):
                away = np.linalg.norm(centers - seen.centers_px[k], axis=1)
                nearest = int(np.argmin(away))
                if ids[nearest] != marker or away[nearest] > SAME_PLACE * SIDE_PX:
                    one["wrong"] += 1
                    continue
                one["found"] += 1
                off = seen.centers_px[k] - centers[nearest]
                one["off_px"].append(float(np.hypot(*off)))
                corners = seen.corners_px[k] - truth.corners_px[nearest]
                one["corners_off_px"].append(float(np.sqrt((corners**2).sum(axis=1).mean())))
                covariance = seen.covariances[k, :2, :2]
                if covariance.any():
                    one["nees"].append(float(off @ np.linalg.solve(covariance, off) / 2))
                    one["plain"].append(int(seen.qualities[k]))
    return row


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--dictionary", default="APRILTAG_36h11")
    parser.add_argument("--detectors", default="photometric,opencv,apriltag3,locus-tag")
    parser.add_argument("--only", default="", help="beginnings of conditions, with commas")
    parser.add_argument("--tuning", action="store_true")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--table", type=Path)
    add_thresholds(parser)
    given = parser.parse_args()
    names = given.detectors.split(",")
    detectors = {name: create_detector(name, dictionary=given.dictionary) for name in names}
    chosen = [
        name
        for name in [*CONDITIONS, *MARGINS]
        if any(name.startswith(start) for start in given.only.split(","))
    ]
    lines = [
        f"| {given.dictionary} | strength | "
        + " | ".join(names)
        + " | wrong | RMS, px | corners, px | NEES | others' NEES |",
        "|---" * (7 + len(names)) + "|",
    ]
    rows = []
    print("\n".join(lines), flush=True)
    for name in chosen:
        row = measure(name, given.dictionary, detectors, tuning=given.tuning)
        rows.append(row)
        ours = row[names[0]]
        others = [n for n, q in zip(ours["nees"], ours["plain"], strict=True) if q < Quality.PHOTOMETRIC]
        cells = [f"{row[key]['found']} of {row['markers']}" for key in names]
        cells.append(", ".join(str(row[key]["wrong"]) for key in names))
        for errors in (ours["off_px"], ours["corners_off_px"]):
            cells.append(f"{np.sqrt(np.mean(np.square(errors))):.3f}" if errors else "–")
        cells += [f"{np.mean(each):.2g} ({len(each)})" if each else "–" for each in (ours["nees"], others)]
        lines.append(f"| {name} | {row['strength']:g} | " + " | ".join(cells) + " |")
        print(lines[-1], flush=True)
    if given.table:
        write_text(given.table, "\n".join(lines) + "\n")
    if given.json:
        write_text(given.json, json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    run(main)
