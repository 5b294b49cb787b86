"""Fallback search for quadrilaterals that the first search pass misses.

The first pass (`skyherd.vision.search.quads`) is fast. Its filters lose the smallest markers and some faint
ones. The fallback search covers places with many dark pixels and no known marker. It searches them at twice
the size, and with OpenCV's detector at its default parameters. Markers that OpenCV detects thus become
candidates of the fit.
"""

import cv2
import numpy as np

from skyherd.geometry import Array, to_points
from skyherd.markers.dictionary import border_cells, load_dictionary
from skyherd.vision.grey import Image
from skyherd.vision.search.quads import small_quads
from skyherd.vision.search.regions import Mosaic, crowded_places


def find_overlooked_quads(image: Image, known_px: Array, dictionary: str) -> Array:
    """Return the corners (N, 4, 2), px, of quadrilaterals outside known markers, by both fallback methods.

    The corners run clockwise in the image and begin with any of the four. Some quadrilaterals may belong to
    a known marker.

    Args:
        image: grey, (height, width).
        known_px: (K, 4, 2) corners of the known markers, px.
        dictionary: name of the marker dictionary.
    """
    places = crowded_places(image, known_px)
    if places is None:
        return np.zeros((0, 4, 2))
    return np.concatenate([small_quads(places), _opencv_quads(places, max(image.shape), dictionary)])


def find_small_quads(image: Image, known_px: Array) -> Array:
    """Return the quadrilaterals of `find_overlooked_quads` from the search at twice the size."""
    places = crowded_places(image, known_px)
    return np.zeros((0, 4, 2)) if places is None else small_quads(places)


def find_opencv_quads(image: Image, known_px: Array, dictionary: str) -> Array:
    """Return the quadrilaterals of `find_overlooked_quads` from OpenCV's detector."""
    places = crowded_places(image, known_px)
    return np.zeros((0, 4, 2)) if places is None else _opencv_quads(places, max(image.shape), dictionary)


def _opencv_quads(places: Mosaic, image_side_px: int, dictionary: str) -> Array:
    """Return the corners (N, 4, 2), px, of the markers that OpenCV detects in places of an image.

    `image_side_px` is the longer side of the whole image, px.
    """
    # OpenCV's limits are shares of the longer side of its input. Scale them to those of the whole image.
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border_cells(dictionary)
    parameters.minMarkerPerimeterRate *= image_side_px / max(places.image.shape)
    parameters.maxMarkerPerimeterRate *= image_side_px / max(places.image.shape)
    detector = cv2.aruco.ArucoDetector(load_dictionary(dictionary), parameters)
    corners, _, _ = detector.detectMarkers(places.image)
    quads = np.reshape(corners, (-1, 4, 2)).astype(float)
    return quads + to_points(places.shifts(quads[:, :, 0].mean(axis=1)))[:, None]
