"""Loads what detectors load or compile when they are first used, before an image waits for it."""

import cv2
import numpy as np

from skyherd.markers.dictionary import marker_cells
from skyherd.vision.detectors.registry import create_detector

CELL_PX, MARGIN_PX = 8, 24
"""Side of a cell and width of the white around the marker, px. *Chosen*: read at the first look."""

BLACK, WHITE, BLUR_PX = 30, 220, 0.8
"""Levels of the marker, and its blur, px. *Chosen*: as usual cameras see one."""

IMAGES = 2
"""Images that a detector is shown. *Chosen*: markers are searched for in the first, and followed in the
second."""


def warm_up(name: str, dictionary: str) -> None:
    """Let a detector of this name find a marker of its dictionary, and forget it.

    The first markers that a process sees take the photometric detectors 0.4 s and more, until their compiled
    code is loaded, and some seconds where it has to be compiled; the next ones a few milliseconds.

    Args:
        name: as `create_detector` takes it.
        dictionary: of the markers.

    Raises:
        InputError: there is no such detector or dictionary.
    """
    detector = create_detector(name, dictionary=dictionary)
    cells = np.kron(marker_cells(dictionary, 0), np.ones((CELL_PX, CELL_PX), dtype=bool))
    sharp = np.pad(np.where(cells, WHITE, BLACK).astype(np.uint8), MARGIN_PX, constant_values=WHITE)
    image = np.asarray(cv2.GaussianBlur(sharp, (0, 0), BLUR_PX), dtype=np.uint8)
    for time_s in range(IMAGES):
        detector.detect(image, time_s=float(time_s))
