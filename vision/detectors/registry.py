"""The interface that every marker detector has, and the creation of detectors by name.

Other detectors need no change here. `create_detector("module:factory")` imports one. A package gives its
detector a name by an entry point in the group `skyherd.detectors`, whose value is such a factory:

    [project.entry-points."skyherd.detectors"]
    own = "own_package:Detector"
"""

import logging
from collections.abc import Callable
from functools import cache, partial
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, cast

import cv2
import numpy as np

from skyherd.errors import InputError, SkyherdError
from skyherd.markers.dictionary import with_border
from skyherd.messages import Detections
from skyherd.messages.checks import check_flags, check_texts
from skyherd.plugins import import_factory
from skyherd.text import one_of
from skyherd.vision.detectors.peers import PeerDetector, peer_names
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.photometric.detector import DeferringDetector, PhotometricDetector

DEFAULT_DETECTOR = "photometric"
"""Detector where none is named: it finds what OpenCV's does and more, and is the most precise."""

DEFAULT_DICTIONARY = "4X4_50"
"""Marker dictionary where none is named: OpenCV's first 50 markers of 4 x 4 bits."""


class Detector(Protocol):
    """Finds oriented square markers of one dictionary in grey images. A new detector implements `detect`.

    **Input.** `image` is an array (height, width) of uint8, row 0 at the top. Callers may pass any array that
    is not grey, of another type or empty: the detector raises InputError for it
    (`skyherd.vision.grey.check_grey` does). It must not change the array or keep a reference to it. An image
    may have any size, and no marker.

    **Coordinates.** Points are (u, v), px, with u to the right and v down; (0, 0) is the *centre* of the
    first pixel. A detector that puts pixel centres at (0.5, 0.5) subtracts that. Headings are angles from +u
    towards +v, rad, of the marker's forward direction: from its centre to the middle of the edge between
    corners 0 and 1, which is row 0 of its cells.

    **Result.** A `skyherd.messages.Detections` with one row for each marker:

    - `unit_id` and `time_s` as they were given, `image_size_px` as (width, height).
    - `ids` (N,), int: indices into the dictionary, mostly each once. Ascending order is customary, but
      nothing relies on it. Every marker of the dictionary that is seen is reported: the detector does not
      know which ids are robots or obstacles, and the receiver ignores ids that it does not know. Squares
      that are no marker of the dictionary are left out.
    - An id that is found several times is left out, as the package's own detectors do, or reported at each
      place: `Detections.repeated` marks it then, and the controller takes it as not seen.
    - `centers_px` (N, 2): image of the marker's centre, or the mean of its corners, which is the same but for
      perspective. `headings_rad` (N,). `sides_px` (N,), positive: side of the black square, the border
      included and the white card not; of a square seen at a slant, the root of its area, or the side of the
      nearest square.
    - `corners_px` (N, 4, 2): corners of the black square, clockwise in the image, beginning with the two
      ahead: front left, front right, back right, back left. They may lie outside the image.
    - `covariances` (N, 3, 3): of (u, v, heading), in px², px·rad and rad². A detector that does not know them
      returns zeros, which mean *unknown*, not *exact*.
    - No marker at all is a result with N = 0, not an error.

    `skyherd.markers.dictionary.pose_of_corners` gives centres, headings and sides from corners, and
    `skyherd.vision.detections_of_corners` makes the whole result of ids and corners.

    **State.** A detector may learn from the images it is given (blur, noise, where markers went), but then
    for each `unit_id` apart: images of several units come by turns. `time_s` increases from one image of a
    unit to the next where times are known; it is 0 for all images where they are not, and then consecutive
    calls are consecutive images. Results may depend on earlier images of the same unit only, and on nothing
    random, so that the same calls on a new detector give the same results. Whoever wants no memory makes a
    new detector. A detector is called from one thread at a time; each process makes its own.

    **Errors.** InputError for an image of the wrong kind. Other exceptions are errors of the detector and are
    passed on.
    """

    def detect(self, image: Image, *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Return the markers found in one image.

        Args:
            image: grey, (height, width), uint8.
            time_s: when the image was taken, s; 0 for all images whose times are not known.
            unit_id: the aerial unit whose image it is.

        Raises:
            InputError: the image is not a grey one of 8 bits, or is empty.
        """
        ...


_DETECTORS: dict[str, Callable[[str], Detector]] = {
    "photometric": lambda dictionary: PhotometricDetector(dictionary, following=False),
    "tracking": PhotometricDetector,
    **{name: partial(PeerDetector, name) for name in peer_names()},
}
"""Functions that make a detector for a dictionary, by the detector's name."""


ENTRY_POINTS = "skyherd.detectors"
"""Group of the entry points by which installed packages add detectors."""

_log = logging.getLogger(__name__)


@cache
def _plugins() -> dict[str, EntryPoint]:
    """Return the detectors of installed packages, by name. Built-in names take precedence."""
    return {entry.name: entry for entry in entry_points(group=ENTRY_POINTS) if entry.name not in _DETECTORS}


def detector_names() -> list[str]:
    """Return the names that `create_detector` knows, in alphabetical order, beside `module:factory`."""
    return sorted({*_DETECTORS, *_plugins()})


INSTEAD = {"aruco": "photometric, or opencv for that of OpenCV alone"}
"""Names that no detector has, and what to use instead."""


def check_detector_name(name: str) -> None:
    """Refuse a name that `create_detector` does not know, without importing a detector.

    Raises:
        InputError: there is no detector of that name.
    """
    if ":" not in name and name not in _DETECTORS and name not in _plugins():
        usual = f"{one_of(name, detector_names())}, or module:factory"
        raise InputError("detector", f"no detector {name!r}", INSTEAD.get(name, usual))


class InvertedDetector:
    """A detector of markers that are white on black, made of one for black ones, which sees negatives."""

    def __init__(self, detector: Detector) -> None:
        self._detector = detector

    def detect(self, image: Image, *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Return the white markers in a grey image (height, width) of 8 bits; see `Detector.detect`."""
        negative = cv2.bitwise_not(check_grey(image))
        return self._detector.detect(np.asarray(negative, dtype=np.uint8), time_s=time_s, unit_id=unit_id)


def create_detector(
    name: str = DEFAULT_DETECTOR,
    *,
    dictionary: str = DEFAULT_DICTIONARY,
    corrected: bool = True,
    border_bits: int = 1,
    inverted: bool = False,
    repeats: bool = False,
    deferring: bool = False,
) -> Detector:
    """Return a new detector, by name or as `module:factory`.

    `module:factory` imports `module`, from the working directory too, and calls its attribute `factory` with
    the dictionary's name; it has to return a `Detector`. A class whose constructor takes the dictionary is
    such a factory.

    Args:
        name: one of `detector_names()`, or `module:factory`.
        dictionary: name of the marker dictionary, such as `APRILTAG_36h11`.
        corrected: False leaves the constant biases and the corner order of the detectors of other libraries
            (`skyherd.vision.detectors.peers`) as they come; it has no effect on other detectors.
        border_bits: width of the markers' black border in cells; calibration boards often have two.
        inverted: whether the markers are white on black.
        repeats: whether ids that are found at several places are reported at each of them, as only
            `photometric` can; `skyherd.messages.Detections.repeated` marks them. They are left out if not.
        deferring: whether a detector that can leaves what can wait to `DeferringDetector.look_around`, as
            `tracking` does; the others have no such method, and do everything at once.

    Raises:
        InputError: there is no detector of that name, it cannot do this, the dictionary is not known or not
            read by it, its library is not installed; or `module:factory` lacks a part, cannot be imported,
            has no such attribute, is not callable, fails, or returns something without a method `detect`.
    """
    check_texts("create_detector", (name, dictionary))
    check_flags(
        "create_detector", corrected=corrected, inverted=inverted, repeats=repeats, deferring=deferring
    )
    dictionary = with_border(dictionary, border_bits)
    if deferring and name == "tracking" and not (inverted or repeats):
        return DeferringDetector(dictionary)
    detector = _create_plain(name, dictionary, corrected=corrected, repeats=repeats)
    return InvertedDetector(detector) if inverted else detector


def _create_plain(name: str, dictionary: str, *, corrected: bool, repeats: bool) -> Detector:
    """A detector of markers that are black on white."""
    check_detector_name(name)
    if repeats:
        if name != "photometric":
            raise InputError("detector", f"{name} leaves out ids that repeat", "photometric for them")
        return PhotometricDetector(dictionary, following=False, repeats=True)
    if ":" in name:
        return _import_detector(name, dictionary)
    if name not in _DETECTORS:
        entry = _plugins()[name]
        _log.info("detector %s is %s of %s", name, entry.value, entry.dist.name if entry.dist else "unknown")
        return _import_detector(entry.value, dictionary)
    if not corrected and name in peer_names():
        return PeerDetector(name, dictionary, corrected=False)
    return _DETECTORS[name](dictionary)


def _import_detector(name: str, dictionary: str) -> Detector:
    """The detector that the factory of `module:factory` returns; InputError says what fails."""
    factory = import_factory(name, f"detector {name}", "a function that takes a dictionary's name")
    try:
        detector = factory(dictionary)
    except SkyherdError:
        raise
    except Exception as error:
        raise InputError(
            f"detector {name}",
            f"{type(error).__name__}: {error}",
            f"factory({dictionary!r}) that returns a detector",
        ) from error
    if not callable(getattr(detector, "detect", None)):
        raise InputError(
            f"detector {name}",
            f"the factory returned {type(detector).__name__}, which has no method detect",
            "an object as described by skyherd.vision.Detector",
        )
    return cast(Detector, detector)


def explain_mirrored(image: Image, dictionary: str) -> str | None:
    """Return what to do if a grey image (height, width) is mirrored, in words; None if it is not.

    A mirrored marker is no marker of its dictionary, except for the few that are their own mirror image (8,
    9, 17 and 47 of 4X4_50). A mirrored stream therefore decodes next to nothing although its markers are
    plain to see, and decodes once it is flipped back: an image counts as mirrored if its mirror image shows
    more.

    Raises:
        InputError: the image is not a grey one of 8 bits, or there is no such dictionary.
    """
    image, detector = check_grey(image), PhotometricDetector(dictionary, following=False, repeats=True)
    flipped = len(detector.detect(np.ascontiguousarray(image[:, ::-1])))
    # Of most images the mirror image shows nothing, and what they show themselves does not matter.
    if not flipped or flipped <= (found := len(detector.detect(image))):
        return None
    decoded = "no marker decodes" if found == 0 else f"only {found} symmetric marker(s) decode"
    return (
        f"the image is mirrored: {decoded} in it, {flipped} in its mirror image; "
        "flip the stream left to right, cv2.flip(image, 1)"
    )
