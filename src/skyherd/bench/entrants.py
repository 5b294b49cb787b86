"""The detectors that are measured: by name skyherd's own and the peers, or any other as `module:factory`."""

import os
import sys
from importlib import import_module
from typing import cast

from skyherd.errors import InputError, SkyherdError
from skyherd.vision import Detector, create_detector, detector_names
from skyherd.vision.detectors.peers import FAMILIES, REFINEMENTS

DEFAULT_DICTIONARY = "4X4_50"
"""Marker dictionary of the frames if none is asked for."""

APRILTAG_DICTIONARY = "APRILTAG_36h11"
"""Dictionary of the frames of AprilTag 3, which knows no other than its own families."""

REFERENCE = "opencv"
"""Times are given as ratios to this one: `cv2.aruco` at its defaults."""


class EntrantError(SkyherdError):
    """A detector raised an exception or crashed while it was measured; exit code 2, as for any bad input."""

    exit_code = 2


def default_entrants() -> list[str]:
    """Names of all detectors, the reference first; AprilTag 3 only where it is installed."""
    names = [REFERENCE, *(name for name in detector_names() if name != REFERENCE)]
    return [name for name in names if name != "apriltag3" or _installed("pupil_apriltags")]


def dictionary_for(name: str, dictionary: str) -> str:
    """Dictionary of the frames for a detector: the one asked for, but for AprilTag 3 one that it knows."""
    return APRILTAG_DICTIONARY if name == "apriltag3" and dictionary not in FAMILIES else dictionary


def make_entrant(name: str, dictionary: str, *, corrected: bool = True) -> Detector:
    """Make a new detector.

    Args:
        name: as `skyherd.vision.create_detector` knows it, or `module:factory` with a function of the
            dictionary that returns a detector; the module is imported from the current folder as well.
        dictionary: of the markers.
        corrected: take the constant biases off that the peers are known to have.

    Raises:
        InputError: there is no detector of that name, or it cannot be made.
    """
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
    """Whether a detector is skyherd's own: neither a peer nor a `module:factory`."""
    return ":" not in name and name not in REFINEMENTS and name != "apriltag3"


def _installed(module: str) -> bool:
    try:
        import_module(module)
    except ImportError:
        return False
    return True
