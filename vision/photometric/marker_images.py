"""Light and blur of the markers in an image, for the set-up of a camera."""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array
from skyherd.markers.dictionary import cells_per_side
from skyherd.messages import Detections
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.photometric.fitting.common_unknowns import OWN_PLANES
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.refine import START_SIGMA_PX, fit_any_blur


@dataclass(frozen=True)
class MarkerImages:
    """Appearance of N markers in an image.

    Attributes:
        blacks: (N,) grey levels of black.
        whites: (N,) grey levels of white.
        blurs_cells: (N,) standard deviations of the blur, lens, motion and pixel together, in cells.
    """

    blacks: Array
    whites: Array
    blurs_cells: Array


def measure_marker_images(image: Image, found: Detections, dictionary: str) -> MarkerImages:
    """Return light and blur of detected markers, each from a fit of its own.

    Args:
        image: grey, (height, width), in which the markers were found.
        found: the markers.
        dictionary: name of the markers' dictionary.

    Raises:
        InputError: the image is not a grey one of 8 bits, or there is no such dictionary.
    """
    image = check_grey(image)
    if not len(found):
        return MarkerImages(*np.zeros((3, 0)))
    start = LocalHomographies.of_quads(found.corners_px)
    noise = image_noise(image)
    fits, _ = fit_any_blur(image, dictionary, found.ids, start, START_SIGMA_PX, OWN_PLANES, noise, alone=True)
    cells_px = fits.homographies.sides_px() / cells_per_side(dictionary)
    return MarkerImages(fits.blacks, fits.blacks + fits.contrasts, fits.sigmas_px / cells_px)
