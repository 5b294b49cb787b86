"""The interface of marker detectors, and the factory function that creates them by name.

`create_detector("module:factory")` imports a detector from another package. A package registers a name for
its detector by an entry point in the group `skyherd.detectors`:

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
from skyherd.markers.dictionary import mirror_symmetric_ids, with_border
from skyherd.messages import Detections
from skyherd.messages.checks import check_flags, check_texts
from skyherd.plugins import import_factory
from skyherd.text import one_of
from skyherd.vision.detectors.peers import PeerDetector, peer_names
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.photometric.detector import DeferringDetector, PhotometricDetector

DEFAULT_DETECTOR = "photometric"
"""Default detector. Chosen: the most accurate, with a recall of at least OpenCV's."""

DEFAULT_DICTIONARY = "4X4_50"
"""Default marker dictionary: OpenCV's first 50 markers of 4 x 4 bits."""


class Detector(Protocol):
    """Detector of the oriented square markers of one dictionary. An implementation defines `detect`.

    **Input.** `image` is an array (height, width) of uint8, row 0 at the top. For an array that is not grey,
    of another type, or empty, the detector raises InputError (`skyherd.vision.grey.check_grey`). The detector
    must not change the array or keep a reference to it. Images of any size, and without markers, are valid.

    **Coordinates.** Points are (u, v), px, u right and v down. (0, 0) is the *centre* of the first pixel. A
    detector with pixel centres at (0.5, 0.5) subtracts 0.5. Headings are angles from +u towards +v, rad, of
    the marker's forward axis. It points from the centre to the middle of the edge between corners 0 and 1,
    which is row 0 of its cells.

    **Result.** A `skyherd.messages.Detections` with one row per marker:

    - `unit_id` and `time_s` are the arguments. `image_size_px` is (width, height).
    - `ids` (N,), int: indices into the dictionary, usually ascending and unique. All visible markers of the
      dictionary are reported. The detector does not distinguish robots from obstacles, and the receiver
      ignores unknown ids. Squares that are not markers of the dictionary are left out.
    - An id that is detected several times is left out, as by the package's own detectors, or reported at each
      place. `Detections.repeated` then marks it, and the controller treats it as not detected.
    - `centers_px` (N, 2): image of the marker's centre, or the mean of its corners. They differ by
      perspective only.
    - `headings_rad` (N,).
    - `sides_px` (N,), positive: side of the black square, with the border and without the white card. Under
      tilt it is the square root of the area, or the side of the nearest square.
    - `corners_px` (N, 4, 2): corners of the black square, clockwise in the image: front left, front right,
      back right, back left. They may lie outside the image.
    - `covariances` (N, 3, 3): of (u, v, heading), in px², px·rad and rad². A detector without covariances
      returns zeros, which mean *unknown*, not *exact*.
    - `qualities` (N,): values of `skyherd.messages.Quality`; `CORNERS` if left out, as for a detector of
      corners.
    - Without markers, N = 0; this is not an error.

    `skyherd.markers.dictionary.pose_of_corners` computes centres, headings and sides from corners.
    `skyherd.vision.detections_of_corners` builds the result from ids and corners.

    **State.** A detector may estimate state from earlier images (blur, noise, tracks), separately for each
    `unit_id`: images of several units may alternate. Results depend only on the present and earlier images of
    the same unit, and on nothing random. The same calls on a new detector give the same results. To discard
    the state, create a new detector. A detector is called from one thread at a time, and each process creates
    its own.

    **Time.** If times are known, `time_s` increases from one image of a unit to the next. If not, it is
    always 0, and consecutive calls are consecutive images.

    **Errors.** InputError for an invalid image. Other exceptions are faults of the detector and are
    propagated.
    """

    def detect(self, image: Image, *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Return the markers detected in one image.

        Args:
            image: grey, (height, width), uint8.
            time_s: time of the image, s; 0 for all images if times are unknown.
            unit_id: aerial unit of the image.

        Raises:
            InputError: the image is not a grey image of uint8, or is empty.
        """
        ...


_DETECTORS: dict[str, Callable[..., Detector]] = {
    "photometric": partial(PhotometricDetector, following=False),
    "quick": partial(PhotometricDetector, following=False, thorough=False),
    "tracking": PhotometricDetector,
    **{name: partial(PeerDetector, name) for name in peer_names()},
}
"""Factories of the built-in detectors, by name; each takes the name of a dictionary."""

REPORT_REPEATS = "photometric", "quick"
"""Detectors that can report an id at every place where it is detected; their factories take `repeats`."""


ENTRY_POINTS = "skyherd.detectors"
"""Entry point group by which installed packages register detectors."""

_log = logging.getLogger(__name__)


@cache
def _plugins() -> dict[str, EntryPoint]:
    """Return the entry points of detectors in installed packages, by name. Built-in names take precedence."""
    return {entry.name: entry for entry in entry_points(group=ENTRY_POINTS) if entry.name not in _DETECTORS}


def detector_names() -> list[str]:
    """Return the names that `create_detector` accepts besides `module:factory`, in alphabetical order."""
    return sorted({*_DETECTORS, *_plugins()})


INSTEAD = {"aruco": "photometric, or opencv for that of OpenCV alone"}
"""Replacements of names that users may expect and that no detector has."""


def check_detector_name(name: str) -> None:
    """Raise an error if `create_detector` does not know the name; import no detector.

    Raises:
        InputError: no detector has that name.
    """
    if ":" not in name and name not in _DETECTORS and name not in _plugins():
        usual = f"{one_of(name, detector_names())}, or module:factory"
        raise InputError("detector", f"no detector {name!r}", INSTEAD.get(name, usual))


class InvertedDetector:
    """Detector of markers that are white on black: runs another detector on the negative image."""

    def __init__(self, detector: Detector) -> None:
        self._detector = detector

    def detect(self, image: Image, *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Return the white markers in a grey image (height, width), uint8; see `Detector.detect`."""
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

    `module:factory` imports `module`, also from the working directory, and calls its attribute `factory` with
    the dictionary's name. The factory returns a `Detector`. It may be a class whose constructor takes the
    dictionary.

    Args:
        name: one of `detector_names()`, or `module:factory`.
        dictionary: name of the marker dictionary, such as `APRILTAG_36h11`.
        corrected: False keeps the constant biases and the corner order of the detectors of other libraries
            (`skyherd.vision.detectors.peers`). Other detectors ignore it.
        border_bits: width of the markers' black border in cells; calibration boards often have two.
        inverted: whether the markers are white on black.
        repeats: whether to report an id at every place where it is detected (`photometric` and `quick` only).
            `skyherd.messages.Detections.repeated` marks such ids. If False, they are left out.
        deferring: whether `tracking` defers searches to `DeferringDetector.look_around`. Other detectors have
            no such method, and search at once.

    Raises:
        InputError: the detector or dictionary is unknown, the detector does not support the dictionary or an
            option, or its library is not installed. For `module:factory`: the module or attribute is missing,
            or the factory fails or returns an object without a method `detect`.
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
    """Return a detector of markers that are black on white."""
    check_detector_name(name)
    if repeats:
        if name not in REPORT_REPEATS:
            raise InputError("detector", f"{name} leaves out ids that repeat", "photometric for them")
        return _DETECTORS[name](dictionary, repeats=True)
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
    """Return the detector of `module:factory`; raise InputError if the import or the factory fails."""
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
    """Return a message to the user if a grey image (height, width) is mirrored, or None.

    A mirrored marker is not a marker of its dictionary, except for the few symmetric ones (8, 9, 17 and 47 of
    4X4_50). An image therefore counts as mirrored if more of the others are detected in its mirror image.

    Raises:
        InputError: the image is not a grey image of uint8, or the dictionary is unknown.
    """
    image, detector = check_grey(image), PhotometricDetector(dictionary, following=False, repeats=True)
    flipped = detector.detect(np.ascontiguousarray(image[:, ::-1]))
    symmetric = mirror_symmetric_ids(dictionary)
    # The mirror image of most images has no marker, and the second detection is then not needed.
    if not len(flipped.without(symmetric)):
        return None
    found = detector.detect(image)
    if len(flipped.without(symmetric)) <= len(found.without(symmetric)):
        return None
    return describe_mirrored(len(found), len(flipped))


def describe_mirrored(found: int, flipped: int) -> str:
    """Return the message about a mirrored image with `found` markers and `flipped` in its mirror image."""
    decoded = "no marker decodes" if found == 0 else f"only {found} symmetric marker(s) decode"
    return (
        f"the image is mirrored: {decoded} in it, {flipped} in its mirror image; "
        "flip the stream left to right, cv2.flip(image, 1)"
    )
