"""The detectors that enter: by name, ours and the peers, or anybody's as `module:factory`."""

import os
import sys
from importlib import import_module
from typing import cast

from skyherd.errors import InputError, SkyherdError
from skyherd.vision import Detector, create_detector, detector_names
from skyherd.vision.detectors.peers import FAMILIES, REFINEMENTS

DEFAULT_DICTIONARY = "4X4_50"
APRILTAG_DICTIONARY = "APRILTAG_36h11"
REFERENCE = "opencv"
"""Times are given as ratios to this one: `cv2.aruco` at its defaults."""


class EntrantError(SkyherdError):
    """A detector that entered broke down; exit code 2, as for any bad input."""

    exit_code = 2


def default_entrants() -> list[str]:
    """All detectors that there are, the reference first; AprilTag 3 only where it is installed."""
    names = [REFERENCE, *(name for name in detector_names() if name != REFERENCE)]
    return [name for name in names if name != "apriltag3" or _installed("pupil_apriltags")]


def dictionary_for(name: str, dictionary: str) -> str:
    """Dictionary of a detector's frames: the one asked for, but for AprilTag 3, which has its own."""
    return APRILTAG_DICTIONARY if name == "apriltag3" and dictionary not in FAMILIES else dictionary


def make_entrant(name: str, dictionary: str, *, corrected: bool = True) -> Detector:
    """A new detector; InputError if there is none of that name or it cannot be made."""
    if ":" not in name:
        return create_detector(name, dictionary=dictionary, corrected=corrected)
    module_name, _, factory_name = name.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        factory = getattr(import_module(module_name), factory_name)
        return cast(Detector, factory(dictionary))
    except Exception as error:
        raise InputError(
            f"detector {name}",
            f"{type(error).__name__}: {error}",
            "`module:factory` with factory(dictionary) that returns a detector, importable from here",
        ) from None


def is_ours(name: str) -> bool:
    """Whether a detector is neither a peer nor a stranger."""
    return ":" not in name and name not in REFINEMENTS and name != "apriltag3"


def _installed(module: str) -> bool:
    try:
        import_module(module)
    except ImportError:
        return False
    return True
