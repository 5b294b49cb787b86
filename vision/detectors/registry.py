"""The one interface every marker detector has, and the detectors by name."""

from collections.abc import Callable
from functools import partial
from typing import Protocol

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.messages import Detections
from skyherd.vision.detectors.opencv_tuned import ArucoDetector
from skyherd.vision.detectors.peers import PeerDetector, peer_names
from skyherd.vision.photometric.detector import PhotometricDetector

Image = npt.NDArray[np.uint8]


class Detector(Protocol):
    """Finds oriented markers in one grey image."""

    def detect(self, image: Image, *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Detections in `image` (height, width), taken at `time_s` by unit `unit_id`."""
        ...


_DETECTORS: dict[str, Callable[[str], Detector]] = {
    "aruco": ArucoDetector,
    "photometric": lambda dictionary: PhotometricDetector(dictionary, following=False),
    "tracking": PhotometricDetector,
    **{name: partial(PeerDetector, name) for name in peer_names()},
}


def detector_names() -> list[str]:
    """Names that `create_detector` knows."""
    return sorted(_DETECTORS)


def create_detector(name: str, *, dictionary: str = "4X4_50", corrected: bool = True) -> Detector:
    """Make a detector by name; InputError names those there are.

    With `corrected=False` the peers (`skyherd.vision.detectors.peers`) keep their constant biases and corner
    order.
    """
    if name not in _DETECTORS:
        raise InputError("detector", f"no detector {name!r}", f"one of {', '.join(detector_names())}")
    if not corrected and name in peer_names():
        return PeerDetector(name, dictionary, corrected=False)
    return _DETECTORS[name](dictionary)


def explain_mirrored(image: Image, dictionary: str) -> str | None:
    """What to say if an image is mirrored, None if it is not.

    A mirrored marker is no marker of its dictionary, but for the few that are their own mirror image (8, 9,
    17 and 47 of 4X4_50): a mirrored stream decodes next to nothing although the markers are plain to see, and
    decodes once it is flipped back. So an image is mirrored if its mirror image shows more.
    """
    detector = ArucoDetector(dictionary)
    found, flipped = (len(detector.detect(view)) for view in (image, np.ascontiguousarray(image[:, ::-1])))
    if flipped <= found:
        return None
    decoded = "no marker decodes" if found == 0 else f"only {found} symmetric marker(s) decode"
    return (
        f"the image is mirrored: {decoded} in it, {flipped} in its mirror image; "
        "flip the stream left to right, cv2.flip(image, 1)"
    )
