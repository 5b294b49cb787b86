"""Measure the constants of `vision/photometric/fitting/correlated_noise.py` on images with white noise.

    python benchmarks/correlated_noise.py

For markers of several sides it prints the number of large boxes and the mean ratio before the correction for
the fit. It also prints the standard deviation of the ratio times the root of the number of boxes.
"""

import numpy as np

from skyherd.bench.detectors.design import Cell
from skyherd.bench.detectors.frames import rendered_frames
from skyherd.vision.photometric.detector import PhotometricDetector
from skyherd.vision.photometric.fitting.correlated_noise import KEPT_SHARE

SIDES_PX, CAMERAS, FRAMES, SEED = (12.0, 16.0, 24.0, 36.0, 60.0), 4, 6, 1


def measure(side_px: float) -> tuple[float, float, float]:
    """Return the mean number of boxes of markers, the mean of their ratios, and the ratios' deviation."""
    ratios, boxes = [], []
    detector = PhotometricDetector("4X4_50", following=False)
    for frame in rendered_frames(Cell(side_px=side_px, cameras=CAMERAS, frames=FRAMES), "4X4_50", SEED):
        for searched in detector.searches(frame.image):
            kept = searched.found.boxes > 0
            ratios.append(searched.found.variance_ratios[kept])
            boxes.append(searched.found.boxes[kept])
    number, found = np.concatenate(boxes), np.concatenate(ratios)
    deviation = float(np.std((found - found.mean(axis=0)) * np.sqrt(number)[:, None]))
    return float(number.mean()), float(KEPT_SHARE * found.mean()), deviation


def main() -> None:
    """Print a line for each side."""
    for side_px in SIDES_PX:
        boxes, ratio, deviation = measure(side_px)
        print(f"{side_px:4.0f} px: {boxes:6.1f} boxes, ratio {ratio:.3f}, deviation {deviation:.2f}")


if __name__ == "__main__":
    main()
