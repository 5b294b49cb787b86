"""The detectors that are measured: by name skyherd's own and the peers, or any other as `module:factory`."""

from importlib import import_module

from skyherd.errors import SkyherdError
from skyherd.vision import (
    APRILTAG_FAMILIES,
    DEFAULT_DICTIONARY,
    Detector,
    create_detector,
    detector_names,
    peer_names,
)

__all__ = [
    "DEFAULT_DICTIONARY",
    "REFERENCE",
    "EntrantError",
    "default_entrants",
    "dictionary_for",
    "is_ours",
    "make_entrant",
]

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
    """Dictionary of a detector's frames: the one asked for, but for AprilTag 3, which has its own."""
    return APRILTAG_DICTIONARY if name == "apriltag3" and dictionary not in APRILTAG_FAMILIES else dictionary


def make_entrant(name: str, dictionary: str, *, corrected: bool = True) -> Detector:
    """A new detector; InputError if there is none of that name or it cannot be made."""
    return create_detector(name, dictionary=dictionary, corrected=corrected)


def is_ours(name: str) -> bool:
    """Whether a detector is skyherd's own: neither a peer nor a `module:factory`."""
    return ":" not in name and name not in peer_names()


def _installed(module: str) -> bool:
    try:
        import_module(module)
    except ImportError:
        return False
    return True
