"""The detector `aruco`: `cv2.aruco` with every length set in pixels, and its measured biases subtracted.

The photometric detector is the package's own. OpenCV's detector stays available beside it in two forms: here
with tuned settings and with its measured mean error of the side subtracted, and untuned, at OpenCV's own
defaults, among the detectors by others (`skyherd.vision.detectors.peers`).
"""

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, IntArray
from skyherd.markers.dictionary import border_cells, load_dictionary, pose_of_corners
from skyherd.messages import Detections
from skyherd.vision.detectors.accuracy import DetectorAccuracy, load_accuracy
from skyherd.vision.detectors.corners import detections_of_corners, opencv_corners
from skyherd.vision.grey import check_grey

MIN_MARKER_SIDE_PX = 8.0
"""Smallest side of an outline that OpenCV looks at, px. Chosen larger than for the photometric detector
(`skyherd.vision.search.quads.MIN_QUAD_SIDE_PX`), since OpenCV decides on each bit by itself: a 4x4 marker of
8 px has little more than a pixel a cell. A smaller value costs time and finds hardly more."""


def _parameters(image_side_px: int, dictionary: str) -> cv2.aruco.DetectorParameters:
    """Settings for an image whose longer side is given: OpenCV's perimeter rates are relative to it."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = 4 * MIN_MARKER_SIDE_PX / image_side_px
    # Thresholds: a window of 5 px separates small markers from their card, 29 px fills larger ones.
    parameters.adaptiveThreshWinSizeMin = 5
    parameters.adaptiveThreshWinSizeMax = 29
    parameters.adaptiveThreshWinSizeStep = 24
    parameters.adaptiveThreshConstant = 13
    parameters.minDistanceToBorder = 1
    parameters.markerBorderBits = border_cells(dictionary)
    parameters.perspectiveRemovePixelPerCell = 10
    parameters.perspectiveRemoveIgnoredMarginPerCell = 0.33
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    return parameters


class ArucoDetector:
    """OpenCV's detector with lines fitted to the markers' contours; implements `skyherd.vision.Detector`.

    The measured mean error of the side is subtracted and the corners are moved out from the centre to match;
    covariances come from the same table (`skyherd.vision.detectors.accuracy`). An id that is found twice in
    an image is left out. Nothing is kept from one image to the next.

    Args:
        dictionary: of the markers.
        corrected: if False, the biases are left in and covariances are zero, which is how the table is
            measured.

    Raises:
        InputError: there is no such dictionary.
    """

    def __init__(self, dictionary: str = "4X4_50", *, corrected: bool = True) -> None:
        load_dictionary(dictionary)
        self.dictionary = dictionary
        self._accuracy: DetectorAccuracy | None = load_accuracy("aruco") if corrected else None
        self._detectors: dict[int, cv2.aruco.ArucoDetector] = {}

    def detect(self, image: npt.NDArray[np.uint8], *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Return the markers in a grey image (height, width) of 8 bits, in ascending order of id.

        Raises:
            InputError: the image is not a grey one of 8 bits.
        """
        image = check_grey(image)
        ids, corners = self._find(image)
        _, headings, sides = pose_of_corners(corners)
        covariances = np.zeros((ids.size, 3, 3))
        if self._accuracy is not None:
            sides = self._accuracy.true_sides_px(sides)
            covariances = self._accuracy.covariances(sides)
        return detections_of_corners(
            image,
            ids,
            corners,
            headings_rad=headings,
            sides_px=sides,
            covariances=covariances,
            time_s=time_s,
            unit_id=unit_id,
        )

    def _find(self, image: npt.NDArray[np.uint8]) -> tuple[IntArray, Array]:
        """Ids (N,), ascending, each once, and corners (N, 4, 2); an id found twice is left out."""
        longer = max(image.shape)
        if longer not in self._detectors:
            dictionary = load_dictionary(self.dictionary)
            self._detectors[longer] = cv2.aruco.ArucoDetector(
                dictionary, _parameters(longer, self.dictionary)
            )
        ids, corners = opencv_corners(self._detectors[longer], image)
        unique, first, count = np.unique(ids, return_index=True, return_counts=True)
        once = count == 1
        return unique[once], corners[first[once]]
