"""The detectors that are measured: by name skyherd's own and the peers, or any other as `module:factory`."""

from importlib.util import find_spec

from skyherd.errors import SkyherdError
from skyherd.vision import (
    APRILTAG_FAMILIES,
    DEFAULT_DICTIONARY,
    LOCUS_FAMILIES,
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
    "missing_libraries",
]

APRILTAG_DICTIONARY = "APRILTAG_36h11"
"""Dictionary of the frames of detectors that do not know the one asked for."""

LIBRARIES = {"apriltag3": "pupil_apriltags", "locus-tag": "locus"}
"""Modules of the libraries that detectors need and that may not be installed."""

FAMILIES = {"apriltag3": APRILTAG_FAMILIES, "locus-tag": LOCUS_FAMILIES}
"""Dictionaries of the detectors that know only a few."""

REFERENCE = "opencv"
"""Times are given as ratios to this one: `cv2.aruco` at its defaults."""


class EntrantError(SkyherdError):
    """A detector raised an exception or crashed while it was measured; exit code 2, as for any bad input."""

    exit_code = 2


def default_entrants() -> list[str]:
    """Names of all detectors whose libraries are installed, the reference first."""
    names = [REFERENCE, *(name for name in detector_names() if name != REFERENCE)]
    return [name for name in names if name not in missing_libraries()]


def missing_libraries() -> list[str]:
    """Names of the detectors whose libraries are not installed."""
    return [name for name, module in LIBRARIES.items() if find_spec(module) is None]


def dictionary_for(name: str, dictionary: str) -> str:
    """Dictionary of a detector's frames: the one asked for, or one that it knows, `APRILTAG_DICTIONARY`."""
    return APRILTAG_DICTIONARY if dictionary not in FAMILIES.get(name, (dictionary,)) else dictionary


def make_entrant(name: str, dictionary: str, *, corrected: bool = True) -> Detector:
    """A new detector; InputError if there is none of that name or it cannot be made."""
    return create_detector(name, dictionary=dictionary, corrected=corrected)


def is_ours(name: str) -> bool:
    """Whether a detector is skyherd's own: neither a peer nor a `module:factory`."""
    return ":" not in name and name not in peer_names()
