"""Quadrilaterals where the first look found no marker: small or slim ones, and those that OpenCV reads.

The first look (`skyherd.vision.search.quads`) is fast, and loses markers of few pixels, which its filters
blur, and some faint ones. Where dark pixels crowd and no marker was found, the places are looked at once
more: at twice their size, and by OpenCV's detector at its default parameters, so that what this detector
finds is among the candidates of the fit.
"""

import cv2
import numpy as np

from skyherd.geometry import Array, to_points
from skyherd.markers.dictionary import border_cells, load_dictionary
from skyherd.vision.grey import Image
from skyherd.vision.search.quads import small_quads
from skyherd.vision.search.regions import Mosaic, crowded_places


def find_overlooked_quads(image: Image, known_px: Array, dictionary: str) -> Array:
    """Return the corners (N, 4, 2), px, of quadrilaterals in places of an image where nothing is known.

    Corners run clockwise as seen and begin with any of the four. Some may be around a square that is known.

    Args:
        image: grey, (height, width).
        known_px: (K, 4, 2) corners of the markers that are known, px.
        dictionary: of the markers.
    """
    places = crowded_places(image, known_px)
    if places is None:
        return np.zeros((0, 4, 2))
    return np.concatenate([small_quads(places), _opencv_quads(places, max(image.shape), dictionary)])


def find_small_quads(image: Image, known_px: Array) -> Array:
    """Return those of `find_overlooked_quads` that are seen at twice the size."""
    places = crowded_places(image, known_px)
    return np.zeros((0, 4, 2)) if places is None else small_quads(places)


def find_opencv_quads(image: Image, known_px: Array, dictionary: str) -> Array:
    """Return those of `find_overlooked_quads` that OpenCV's detector finds."""
    places = crowded_places(image, known_px)
    return np.zeros((0, 4, 2)) if places is None else _opencv_quads(places, max(image.shape), dictionary)


def _opencv_quads(places: Mosaic, image_side_px: int, dictionary: str) -> Array:
    """Corners (N, 4, 2) of the markers that OpenCV's detector finds in places of an image.

    Its limits are shares of the longer side of the image that it is given; here they are those that it has
    in the whole image, whose longer side is `image_side_px`.
    """
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border_cells(dictionary)
    parameters.minMarkerPerimeterRate *= image_side_px / max(places.image.shape)
    parameters.maxMarkerPerimeterRate *= image_side_px / max(places.image.shape)
    detector = cv2.aruco.ArucoDetector(load_dictionary(dictionary), parameters)
    corners, _, _ = detector.detectMarkers(places.image)
    quads = np.reshape(corners, (-1, 4, 2)).astype(float)
    return quads + to_points(places.shifts(quads[:, :, 0].mean(axis=1)))[:, None]
