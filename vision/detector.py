"""The one interface every marker detector has, and the detectors by name."""

from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.messages import Detections
from skyherd.vision.aruco import ArucoDetector

Image = npt.NDArray[np.uint8]


class Detector(Protocol):
    """Finds oriented markers in one grey image."""

    def detect(self, image: Image, *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Detections in `image` (height, width), taken at `time_s` by unit `unit_id`."""
        ...


_DETECTORS = {"aruco": ArucoDetector}


def detector_names() -> list[str]:
    """Names that `create_detector` knows."""
    return sorted(_DETECTORS)


def create_detector(name: str, *, dictionary: str = "4X4_50") -> Detector:
    """Make a detector by name; InputError names those there are."""
    if name not in _DETECTORS:
        raise InputError("detector", f"no detector {name!r}", f"one of {', '.join(detector_names())}")
    return _DETECTORS[name](dictionary)


def explain_nothing_decoded(detector: Detector, image: Image) -> str | None:
    """Why an image in which nothing was found shows nothing, where that can be told.

    A mirrored marker is no marker of its dictionary, so that a mirrored stream decodes nothing although
    the markers are plain to see; it decodes once it is flipped back.
    """
    found = len(detector.detect(np.ascontiguousarray(cv2.flip(image, 1))))
    if found:
        return (
            f"the image is mirrored: no marker decodes in it, {found} do in its mirror image; "
            "flip the stream left to right, cv2.flip(image, 1)"
        )
    return None
