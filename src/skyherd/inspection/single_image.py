"""Detection in one image and its annotation, with one call each: `skyherd.detect` and `skyherd.annotate`."""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.files.images import Grey, read_grey
from skyherd.geometry import RgbImage
from skyherd.inspection.annotator import MIN_SIDE_PX, Annotator
from skyherd.inspection.inspector import AUTO
from skyherd.messages import Detections
from skyherd.messages.checks import check_kind
from skyherd.vision import DEFAULT_DETECTOR, DEFAULT_DICTIONARY, create_detector, find_dictionary

ImageLike = npt.NDArray[np.uint8] | str | Path
"""An image: an array, grey (height, width) or BGR (height, width, 3), of uint8; or the path of a picture."""

ALLOWED = "a path, or an array of uint8, grey (height, width) or BGR (height, width, 3)"
"""Allowed images, in words."""


def detect(
    image: ImageLike,
    *,
    dictionary: str = DEFAULT_DICTIONARY,
    detector: str = DEFAULT_DETECTOR,
    border_bits: int = 1,
    inverted: bool = False,
    repeats: bool = False,
) -> Detections:
    """Return the markers in one image, with covariances.

    Each call uses a new detector. For the images of a video, call `create_detector` once instead.

    Args:
        image: an array of uint8, grey (height, width) or BGR (height, width, 3) as OpenCV reads it; or the
            path of a picture.
        dictionary: name of the marker dictionary, such as `APRILTAG_36h11`; `auto` tries all of them.
        detector: name of a detector, or `module:factory`.
        border_bits: width of the markers' black border in cells.
        inverted: whether the markers are white on black.
        repeats: whether to report an id that is found at several places at each of them.

    Raises:
        InputError: the image is not of an allowed kind, the picture cannot be read, or an option is unknown.

    Examples:
        >>> import skyherd
        >>> mission = skyherd.load_mission("triangle", {"duration_s": 0.1})
        >>> step = next(iter(skyherd.run_steps(mission)))
        >>> found = skyherd.detect(step.frames[0].sight.image)
        >>> found
        Detections(6 marker(s): 0, 1, 2, 3, 4, 5; 800x800 px, unit 0, 0 s)
        >>> found[2].id, found[2].center_px.shape, found[2].quality.name
        (2, (2,), 'PHOTOMETRIC')
    """
    grey = as_grey(image)
    check_kind("detect: dictionary", dictionary, str, "a dictionary's name, or auto")
    if dictionary == AUTO:
        found = find_dictionary(grey, border_bits=border_bits, inverted=inverted)
        dictionary = found or DEFAULT_DICTIONARY
    finder = create_detector(
        detector, dictionary=dictionary, border_bits=border_bits, inverted=inverted, repeats=repeats
    )
    return finder.detect(grey)


def annotate(image: ImageLike, detections: Detections, *, min_side_px: int = MIN_SIDE_PX) -> RgbImage:
    """Return an RGB picture of an image in grey, with the outline, forward arrow and id of each marker.

    Args:
        image: the image of the detections, as `detect` takes it.
        detections: the markers to draw.
        min_side_px: the longer side of the picture, at least. A smaller image is enlarged by a whole factor;
            1 keeps every size.

    Raises:
        InputError: the image is not of an allowed kind, or of another size than that of the detections.
    """
    check_kind("annotate: detections", detections, Detections, "Detections, as detect returns them")
    check_kind("annotate: min_side_px", min_side_px, (int, np.integer), "a whole number above 0")
    if min_side_px < 1:
        raise InputError("annotate: min_side_px", str(min_side_px), "a whole number above 0")
    grey = as_grey(image)
    size_px, own_px = grey.shape[::-1], tuple(detections.image_size_px.astype(int).tolist())
    if size_px != own_px:
        what = f"{size_px[0]}x{size_px[1]} px"
        raise InputError("annotate: image", what, f"the image of the detections, {own_px[0]}x{own_px[1]} px")
    return Annotator(size_px, min_side_px=int(min_side_px)).draw(grey, detections)


def as_grey(image: ImageLike) -> Grey:
    """Return an image as grey levels (height, width): read a path, convert BGR, and keep grey arrays.

    Raises:
        InputError: the image is not of an allowed kind, or the picture cannot be read.
    """
    if isinstance(image, str | Path):
        return read_grey(Path(image))
    if not isinstance(image, np.ndarray):
        raise InputError("image", f"a {type(image).__name__}", ALLOWED)
    channels = image.shape[2:] or (1,)
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or channels[0] not in (1, 3) or not image.size:
        raise InputError("image", f"shape {image.shape}, {image.dtype}", ALLOWED)
    if channels[0] == 3:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    return np.ascontiguousarray(image.reshape(image.shape[:2]))
