"""Benchmarked detectors: skyherd's own and the peers by name, or any other as `module:factory`."""

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
"""Fallback dictionary for detectors that do not support the requested one."""

LIBRARIES = {"apriltag3": "pupil_apriltags", "locus-tag": "locus", "napa": "napa_vision"}
"""Modules of optional libraries that detectors need."""

NO_EXTRA = ("napa",)
"""Detectors whose libraries no extra installs, because their licences exclude commercial use."""

FAMILIES = {"apriltag3": APRILTAG_FAMILIES, "locus-tag": LOCUS_FAMILIES, "napa": APRILTAG_FAMILIES}
"""Supported dictionaries of detectors that support only a few."""

REFERENCE = "opencv"
"""Reference of time ratios: `cv2.aruco` at its defaults."""


class EntrantError(SkyherdError):
    """Failure of a detector during measurement, by exception or crash; exit code 2, as for bad input."""

    exit_code = 2


def default_entrants() -> list[str]:
    """List all detectors whose libraries are installed, the reference first."""
    names = [REFERENCE, *(name for name in detector_names() if name != REFERENCE)]
    return [name for name in names if name not in LIBRARIES or find_spec(LIBRARIES[name]) is not None]


def missing_libraries() -> list[str]:
    """List the detectors whose libraries are not installed although the extra `peers` has them."""
    return [name for name, module in LIBRARIES.items() if name not in NO_EXTRA and find_spec(module) is None]


def dictionary_for(name: str, dictionary: str) -> str:
    """Return the dictionary of a detector's frames: the requested one, or a supported one."""
    return APRILTAG_DICTIONARY if dictionary not in FAMILIES.get(name, (dictionary,)) else dictionary


def make_entrant(name: str, dictionary: str, *, corrected: bool = True) -> Detector:
    """Create a new detector; InputError if its name is unknown or it cannot be created."""
    return create_detector(name, dictionary=dictionary, corrected=corrected)


def is_ours(name: str) -> bool:
    """Return whether a detector is skyherd's own: neither a peer nor a `module:factory`."""
    return ":" not in name and name not in peer_names()
