"""Measure a detector's recall, biases and errors by marker size, on rendered images.

    python benchmarks/detector_accuracy.py            # print the table
    python benchmarks/detector_accuracy.py --write    # and store it where the package reads it
    python benchmarks/detector_accuracy.py --detector opencv

Markers of the dictionary 4X4_50 at random places and headings, on textured ground. The tables are those that
noise is drawn from where perception is `noisy`.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from skyherd.markers.dictionary import card_side, pose_of_corners
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, project_markers
from skyherd.vision import DEFAULT_DETECTOR, Detector, create_detector

DICTIONARY = "4X4_50"
IMAGE_PX = 800
PER_FRAME = 16
SIDES_PX = (10, 12, 13, 14, 15, 16, 18, 20, 22, 24, 27, 30, 35, 40, 45, 50, 60, 80)
DETECTORS = (DEFAULT_DETECTOR, "opencv")
TABLES = Path(__file__).parent.parent / "vision" / "detectors"


@dataclass(frozen=True)
class SizeResult:
    """What was measured at one true side; errors over the markers found."""

    side_px: float
    markers: int
    recall: float
    false_detections: int
    side_bias_px: float
    side_std_px: float
    position_bias_px: float
    position_std_px: float
    heading_std_deg: float


def measure(
    side_px: float, frames: int, renderer: Renderer, detector: Detector, rng: np.random.Generator
) -> SizeResult:
    """Render `frames` images of markers of `side_px` and compare what is found with the truth."""
    found, errors = 0, []
    false = 0
    for _ in range(frames):
        camera = Camera((IMAGE_PX, IMAGE_PX), focal_px=10.0 * side_px)
        pose = CameraPose((rng.uniform(-20, 20), rng.uniform(-20, 20)), 10.0, rng.uniform(-np.pi, np.pi))
        positions, headings = _spread(pose, side_px, rng), rng.uniform(-np.pi, np.pi, PER_FRAME)
        ids = np.sort(rng.permutation(50)[:PER_FRAME])
        seen = detector.detect(renderer.render(camera, pose, ids, positions, headings))
        truth = project_markers(camera, pose, positions, headings, 1.0, card_side(DICTIONARY))
        centers, true_headings, sides = pose_of_corners(truth.corners_px)
        row = np.searchsorted(ids, seen.ids).clip(max=PER_FRAME - 1)
        right = (ids[row] == seen.ids) & (
            np.linalg.norm(centers[row] - seen.centers_px, axis=1) < side_px / 2
        )
        found, false = found + int(right.sum()), false + int((~right).sum())
        turn = np.angle(np.exp(1j * (seen.headings_rad - true_headings[row])))
        errors.append(
            np.column_stack([seen.centers_px - centers[row], turn, seen.sides_px - sides[row]])[right]
        )
    error = np.concatenate(errors)
    return SizeResult(
        side_px=side_px,
        markers=frames * PER_FRAME,
        recall=found / (frames * PER_FRAME),
        false_detections=false,
        side_bias_px=float(error[:, 3].mean()),
        side_std_px=float(error[:, 3].std()),
        position_bias_px=float(np.abs(error[:, :2].mean(axis=0)).max()),
        position_std_px=float(np.sqrt((error[:, :2] ** 2).mean())),
        heading_std_deg=float(np.degrees(np.sqrt((error[:, 2] ** 2).mean()))),
    )


def _spread(pose: CameraPose, side_px: float, rng: np.random.Generator) -> np.ndarray:
    """A jittered 4 by 4 grid of positions in view, in marker sides (one side is one metre)."""
    spacing = (IMAGE_PX / side_px - 2.5) / 4
    column, row = np.meshgrid(np.arange(4) - 1.5, np.arange(4) - 1.5)
    jitter = rng.uniform(-0.5, 0.5, (PER_FRAME, 2)) * max(spacing - 2.2, 0.0)
    offset = spacing * (column.ravel() + 1j * row.ravel()) + jitter[:, 0] + 1j * jitter[:, 1]
    at = complex(*pose.position_m) + offset * np.exp(1j * pose.yaw_rad)
    return np.column_stack([at.real, at.imag])


def as_toml(results: list[SizeResult], detector: str, noise: float, psf_px: float) -> str:
    """The table as the detector reads it."""
    head = (
        f"# Errors of the detector `{detector}`, by `benchmarks/detector_accuracy.py --write`.\n"
        f"# OpenCV {cv2.__version__}; RMS over markers found. Linear between sizes.\n"
        f'dictionary = "{DICTIONARY}"\nnoise = {noise}\npsf_px = {psf_px}\n'
    )
    rows = [
        f"[[size]]\nside_px = {r.side_px}\nrecall = {r.recall:.4f}\nside_bias_px = {r.side_bias_px:.4f}\n"
        f"position_std_px = {r.position_std_px:.4f}\nheading_std_deg = {r.heading_std_deg:.4f}\n"
        for r in results
    ]
    return "\n".join([head, *rows])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--detector", choices=DETECTORS, default=DEFAULT_DETECTOR)
    parser.add_argument("--frames", type=int, default=100, help=f"images a size, {PER_FRAME} markers each")
    parser.add_argument("--noise", type=float, default=2.0, help="grey levels")
    parser.add_argument("--psf", type=float, default=0.8, help="blur, px")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", action="store_true", help=f"store it in {TABLES}")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rng = np.random.default_rng(options.seed)
    ground = Ground(options.seed, sigma_px=float(np.hypot(options.psf, np.sqrt(1 / 12))))
    renderer = Renderer(DICTIONARY, 1.0, ground, Sensor(options.noise, rng), psf_px=options.psf)
    detector = create_detector(options.detector, dictionary=DICTIONARY)
    print("side_px  recall  false  side bias ± std px   position bias / RMS px   heading RMS deg")
    results = []
    for side_px in SIDES_PX:
        r = measure(float(side_px), options.frames, renderer, detector, rng)
        results.append(r)
        print(
            f"{r.side_px:7.0f}  {r.recall:6.4f}  {r.false_detections:5d}  "
            f"{r.side_bias_px:+9.3f} ± {r.side_std_px:.3f}"
            f"   {r.position_bias_px:13.4f} / {r.position_std_px:.4f}   {r.heading_std_deg:12.3f}",
            flush=True,
        )
    if options.write:
        table = TABLES / f"{options.detector}_accuracy.toml"
        table.write_text(as_toml(results, options.detector, options.noise, options.psf), "utf-8")
        print(f"written: {table}")


if __name__ == "__main__":
    main()
