"""Measure a detector's recall and errors by size of code, noise, blur and marker size, on rendered images.

```sh
python benchmarks/detector_accuracy.py --quick                    # one noise, one blur, one code
python benchmarks/detector_accuracy.py --write                    # all, stored where the package reads it
python benchmarks/detector_accuracy.py --detector opencv --write
```

Markers have random places and headings on textured ground. Cameras are tilted by TILT_RAD. Perception
`noisy` draws its errors and missed markers from these tables. Errors are of the found markers. With fewer
than FEWEST of them, the table has the errors of the next larger size.
"""

import argparse
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import cv2
import numpy as np

from skyherd.geometry import ComplexArray, to_complex
from skyherd.markers.dictionary import cells_per_side
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot
from skyherd.vision import DEFAULT_DETECTOR, Detector, create_detector

DICTIONARIES = ("4X4_50", "5X5_100", "6X6_250")
NOISES = (2.0, 5.0, 10.0)
BLURS_PX = (0.5, 0.8, 1.2)
CELL_PX = (1.2, 1.4, 1.6, 1.8, 2.0, 2.25, 2.5, 3.0, 4.0, 6.0, 10.0)
TILT_RAD = float(np.radians(5.0))
IMAGE_PX, FOCAL_PX = 800, 1000.0
PER_FRAME = 16
FEWEST = 20
DETECTORS = (DEFAULT_DETECTOR, "opencv")
TABLES = Path(__file__).parent.parent / "vision" / "detectors"


@dataclass(frozen=True)
class SizeResult:
    """Results at one true side: errors of the found markers; those of side and shape are relative."""

    recall: float
    position_std_px: float
    heading_std_deg: float
    side_std: float
    squeeze_std: float
    false_detections: int = 0


COLUMNS = tuple(field.name for field in fields(SizeResult))[:-1]


def measure(
    side_px: float,
    frames: int,
    *,
    dictionary: str,
    renderer: Renderer,
    detector: Detector,
    rng: np.random.Generator,
) -> SizeResult:
    """Render `frames` images of markers of `side_px` and compare what is found with the truth."""
    found, whole, false, errors = 0, 0, 0, []
    for _ in range(frames):
        camera = Camera((IMAGE_PX, IMAGE_PX), focal_px=FOCAL_PX)
        tilt = TILT_RAD * np.exp(2j * np.pi * rng.random())
        place, yaw_rad = (rng.uniform(-20, 20), rng.uniform(-20, 20)), rng.uniform(-np.pi, np.pi)
        pose = CameraPose(place, FOCAL_PX / side_px, yaw_rad, (tilt.real, tilt.imag))
        positions, headings = _spread(pose, side_px, rng), rng.uniform(-np.pi, np.pi, PER_FRAME)
        ids = np.sort(rng.permutation(50)[:PER_FRAME])
        seen = detector.detect(renderer.render(Shot(camera, pose, ids, positions, headings)))
        truth = renderer.truth(Shot(camera, pose, ids, positions, headings))
        row = np.searchsorted(truth.ids, seen.ids).clip(max=truth.ids.size - 1)
        away_px = np.linalg.norm(truth.centers_px[row] - seen.centers_px, axis=1)
        right = (truth.ids[row] == seen.ids) & (away_px < side_px / 2)
        false += int((~right).sum())
        right &= truth.whole[row]
        found, whole = found + int(right.sum()), whole + int(truth.whole.sum())
        have, want = to_complex(seen.corners_px[right]), to_complex(truth.corners_px[row[right]])
        turn, grown, squeeze = _shape_errors(have, want)
        errors.append(
            np.column_stack(
                [(seen.centers_px - truth.centers_px[row])[right], turn, grown, squeeze.real, squeeze.imag]
            )
        )
    error = np.concatenate(errors)
    if len(error) < FEWEST:
        nan = float("nan")
        return SizeResult(found / whole, nan, nan, nan, nan, false)
    rms = np.sqrt((error**2).mean(axis=0))
    return SizeResult(
        recall=found / whole,
        position_std_px=float(np.sqrt((rms[:2] ** 2).mean())),
        heading_std_deg=float(np.degrees(rms[2])),
        side_std=float(rms[3]),
        squeeze_std=float(np.sqrt((rms[4:] ** 2).mean())),
        false_detections=false,
    )


def _shape_errors(measured: ComplexArray, true: ComplexArray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rotation (N,), rad, growth (N,) and anisotropy (N,) from true to measured corners (N, 4).

    With corners as complex numbers about their middle, `m = s t + q conj(t)` is fitted by least squares; the
    turn is `arg s`, the growth `|s| - 1`, the anisotropy `q`.
    """
    measured, true = (z - z.mean(axis=1, keepdims=True) for z in (measured, true))
    parts = np.stack([true, true.conj()], axis=-1)
    s, q = np.moveaxis(np.linalg.pinv(parts) @ measured[..., None], 0, -1)[:, 0]
    return np.angle(s), np.abs(s) - 1, q


def _spread(pose: CameraPose, side_px: float, rng: np.random.Generator) -> np.ndarray:
    """Return positions on a jittered 4 by 4 grid in view, in marker sides (one side is one metre)."""
    spacing = (IMAGE_PX / side_px - 2.5) / 4
    column, row = np.meshgrid(np.arange(4) - 1.5, np.arange(4) - 1.5)
    jitter = rng.uniform(-0.5, 0.5, (PER_FRAME, 2)) * max(spacing - 2.2, 0.0)
    offset = spacing * (column.ravel() + 1j * row.ravel()) + jitter[:, 0] + 1j * jitter[:, 1]
    at = complex(*pose.position_m) + offset * np.exp(1j * pose.yaw_rad)
    return np.column_stack([at.real, at.imag])


def as_toml(grid: np.ndarray, detector: str, frames: int) -> str:
    """Return the table as the package reads it, of a grid (codes, noises, blurs, sizes, columns)."""
    lines = [
        f"# What the detector `{detector}` finds, and its errors (RMS over markers found), by",
        f"# `benchmarks/detector_accuracy.py --write`: {frames * PER_FRAME} markers each.",
        f"# OpenCV {cv2.__version__}, cameras tilted by {np.degrees(TILT_RAD):.0f} degrees.",
        "# Of each code the values are by noise, blur and size of a cell; side and squeeze as shares.",
        f"noise = {list(NOISES)}",
        f"psf_px = {list(BLURS_PX)}",
        f"cell_px = {list(CELL_PX)}",
    ]
    for dictionary, values in zip(DICTIONARIES, grid, strict=True):
        lines += ["", "[[codes]]", f'dictionary = "{dictionary}"', f"cells = {cells_per_side(dictionary)}"]
        for column, name in enumerate(COLUMNS):
            rows = ("  [" + ", ".join(_row(blur[:, column]) for blur in noise) + "]," for noise in values)
            lines += [f"{name} = [", *rows, "]"]
    return "\n".join(lines) + "\n"


def _row(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{value:.3g}" for value in values) + "]"


def fill(values: np.ndarray) -> np.ndarray:
    """Return values (sizes, columns) with unknown errors replaced by those of the next larger size."""
    values = values.copy()
    for size in range(len(values) - 2, -1, -1):
        values[size] = np.where(np.isnan(values[size]), values[size + 1], values[size])
    return values


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--detector", choices=DETECTORS, default=DEFAULT_DETECTOR)
    parser.add_argument("--frames", type=int, default=20, help=f"images a size, {PER_FRAME} markers each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="the first code, noise 2 and blur 0.8 px alone")
    parser.add_argument("--write", action="store_true", help=f"store it in {TABLES}")
    options = parser.parse_args()
    if options.quick and options.write:
        parser.error("--write takes all codes, noises and blurs")
    cv2.setNumThreads(1)
    codes = DICTIONARIES[:1] if options.quick else DICTIONARIES
    noises, blurs = ((2.0,), (0.8,)) if options.quick else (NOISES, BLURS_PX)
    grid = np.full((len(codes), len(noises), len(blurs), len(CELL_PX), len(COLUMNS)), np.nan)
    print("code      noise  blur px  side px  recall  false  position px  heading deg    side  squeeze")
    for place in np.ndindex(grid.shape[:3]):
        dictionary, noise, psf_px = codes[place[0]], noises[place[1]], blurs[place[2]]
        rng = np.random.default_rng([options.seed, *place])
        ground = Ground(options.seed, sigma_px=float(np.hypot(psf_px, np.sqrt(1 / 12))))
        renderer = Renderer(dictionary, 1.0, ground, Sensor(noise, rng), psf_px=psf_px)
        detector = create_detector(options.detector, dictionary=dictionary)
        for size, cell_px in enumerate(CELL_PX):
            side_px = cell_px * cells_per_side(dictionary)
            r = measure(
                side_px, options.frames, dictionary=dictionary, renderer=renderer, detector=detector, rng=rng
            )
            grid[place][size] = astuple(r)[:-1]
            print(
                f"{dictionary:8s} {noise:6.0f} {psf_px:8.1f} {side_px:8.1f}  {r.recall:6.4f} "
                f"{r.false_detections:6d} {r.position_std_px:12.4f} {r.heading_std_deg:12.3f} "
                f"{r.side_std:8.5f} {r.squeeze_std:8.5f}",
                flush=True,
            )
        grid[place] = fill(grid[place])
    if options.write:
        table = TABLES / f"{options.detector}_accuracy.toml"
        table.write_text(as_toml(grid, options.detector, options.frames), "utf-8")
        print(f"written: {table}")


if __name__ == "__main__":
    main()
