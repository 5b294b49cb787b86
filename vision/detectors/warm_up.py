"""Loads and compiles the code of a detector before its first image."""

import cv2
import numpy as np

from skyherd.markers.dictionary import marker_cells
from skyherd.vision.detectors.registry import create_detector

CELL_PX, MARGIN_PX = 8, 24
"""Cell side and width of the white margin, px. Chosen: the first search pass finds such a marker."""

BLACK, WHITE, BLUR_PX = 30, 220, 0.8
"""Grey levels of the marker, and its blur, px. Chosen: typical of a camera."""

IMAGES = 2
"""Number of images. Chosen: the detector searches in the first image and follows in the second."""


def warm_up(name: str, dictionary: str) -> None:
    """Run a detector of this name on images of one marker, to load or compile its code.

    In a new process, the first image with markers takes a photometric detector at least 0.4 s with cached
    compiled code, and several seconds without. Later images take a few milliseconds.

    Args:
        name: as in `create_detector`.
        dictionary: name of the marker dictionary.

    Raises:
        InputError: the detector or the dictionary is unknown.
    """
    detector = create_detector(name, dictionary=dictionary)
    cells = np.kron(marker_cells(dictionary, 0), np.ones((CELL_PX, CELL_PX), dtype=bool))
    sharp = np.pad(np.where(cells, WHITE, BLACK).astype(np.uint8), MARGIN_PX, constant_values=WHITE)
    image = np.asarray(cv2.GaussianBlur(sharp, (0, 0), BLUR_PX), dtype=np.uint8)
    for time_s in range(IMAGES):
        detector.detect(image, time_s=float(time_s))
