"""Detectors by others behind the package's interface: `cv2.aruco` as it comes, AprilTag 3, and locus-tag.

They run at their own defaults, which is what their users have. Constant errors are subtracted and documented
here; with `corrected=False` they are left in:

- the point taken as a pixel's centre: OpenCV's APRILTAG refinement is off by +0.46 px in u and v, AprilTag 3
  and locus-tag by +0.50 px;
- the marker's side, which OpenCV's refinements and contours make too short by 0.6 to 1.3 px at any size;
- the order of the corners: AprilTag's run the other way round from OpenCV's, and its tags stand upside down,
  so that headings differ by 180 degrees. Those of locus-tag are OpenCV's, in all its families.

`benchmarks/peer_biases.py --write` measures the first two into `peer_biases.toml`. Of the poses that four
corners give, these detectors get the best one: the centre is the mean of the corners, and the heading that of
the nearest square in the plane of the image's markers (`headings_in_plane`). None of them reports a
covariance, and none is made up: theirs are zero, which means unknown.
"""

from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.geometry import Array, IntArray, fit_squares, to_complex
from skyherd.markers.dictionary import border_cells, load_dictionary, pose_of_corners
from skyherd.messages import Detections
from skyherd.messages.checks import shown
from skyherd.vision.detectors.accuracy import load_bias
from skyherd.vision.detectors.corners import detections_of_corners, opencv_corners
from skyherd.vision.grey import check_grey
from skyherd.vision.photometric.fitting.plane import squeeze_design_matrix

REFINEMENTS = {
    "opencv": cv2.aruco.CORNER_REFINE_NONE,
    "opencv-subpix": cv2.aruco.CORNER_REFINE_SUBPIX,
    "opencv-contour": cv2.aruco.CORNER_REFINE_CONTOUR,
    "opencv-apriltag": cv2.aruco.CORNER_REFINE_APRILTAG,
}
"""Peers made of `cv2.aruco`, by name: its default parameters with each of its corner refinements."""

APRILTAG_FAMILIES = {"APRILTAG_16h5": "tag16h5", "APRILTAG_25h9": "tag25h9", "APRILTAG_36h11": "tag36h11"}
"""OpenCV's dictionaries that AprilTag 3 can read, with the names that pupil-apriltags has for them."""

APRILTAG_CORNERS, OPENCV_CORNERS = [3, 2, 1, 0], [1, 0, 3, 2]
"""Indices into AprilTag's corners that put them clockwise from its own top left, and from OpenCV's corner 0
of the same marker."""

LOCUS_FAMILIES = {
    "4X4_50": "ArUco4x4_50",
    "4X4_100": "ArUco4x4_100",
    "6X6_250": "ArUco6x6_250",
    "ARUCO_MIP_36h12": "ArUcoMip36h12",
    "APRILTAG_16h5": "AprilTag16h5",
    "APRILTAG_36h11": "AprilTag36h11",
}
"""Dictionaries that locus-tag can read, with the names that it has for them."""

TILT_MIN_MARKERS = 3
"""Smallest number of markers from which a tilt is estimated. Derived: two markers have as many squeezes as
the plane has unknowns, so that nothing would be averaged."""


class _Finder(Protocol):
    def find(self, image: npt.NDArray[np.uint8], *, corrected: bool) -> tuple[IntArray, Array]:
        """Ids (K,), repeated ones too, and corners (K, 4, 2)."""
        ...


class PeerDetector:
    """A detector of another library, by name; implements `skyherd.vision.Detector`.

    Of an id that is found several times, the largest quadrilateral counts. Covariances are zero, which means
    unknown. Nothing is kept from one image to the next.

    Args:
        name: one of `peer_names()`.
        dictionary: of the markers.
        corrected: whether constant biases are subtracted and corners put in the package's order.

    Raises:
        InputError: there is no such dictionary, the library does not know it, or it is not installed.
    """

    def __init__(self, name: str, dictionary: str, *, corrected: bool = True) -> None:
        if name not in (known := (*REFINEMENTS, *_OTHERS)):
            raise InputError("PeerDetector: name", shown(name), f"one of {', '.join(known)}")
        self.name, self.corrected = name, corrected
        self._finder: _Finder = (
            _OpenCV(dictionary, REFINEMENTS[name]) if name in REFINEMENTS else _OTHERS[name](dictionary)
        )

    def detect(self, image: npt.NDArray[np.uint8], *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Return the markers in a grey image (height, width) of 8 bits, in ascending order of id.

        Raises:
            InputError: the image is not a grey one of 8 bits.
        """
        image = check_grey(image)
        ids, corners = _largest_of_each(*self.find_all(image))
        return detections_of_corners(
            image,
            ids,
            corners,
            headings_rad=headings_in_plane(corners),
            sides_px=pose_of_corners(corners)[2],
            covariances=np.zeros((ids.size, 3, 3)),
            time_s=time_s,
            unit_id=unit_id,
        )

    def find_all(self, image: npt.NDArray[np.uint8]) -> tuple[IntArray, Array]:
        """Return ids (K,), which may repeat, and corners (K, 4, 2), px, of all that is found in an image.

        Corners are corrected as those that `detect` returns. Quadrilaterals without an area are left out.

        Raises:
            InputError: the image is not a grey one of 8 bits.
        """
        ids, corners = self._finder.find(check_grey(image), corrected=self.corrected)
        centers, _, sides = pose_of_corners(corners)
        whole = sides > 0
        ids, corners, centers, sides = ids[whole], corners[whole], centers[whole, None], sides[whole]
        if self.corrected:
            bias = load_bias(self.name)
            growth = (bias.true_sides_px(sides) / sides)[:, None, None]
            corners = centers + (corners - centers) * growth - bias.position_px
        return ids, corners


def peer_names() -> list[str]:
    """Return the names of the detectors by others, whether their libraries are installed or not."""
    return [*REFINEMENTS, *_OTHERS]


def headings_in_plane(corners_px: Array) -> Array:
    """Return headings (N,), rad, of markers with corners (N, 4, 2) in one plane, which may be tilted.

    Seen at a slant, a marker with arm m at p has the squeeze `k = (α - p λ / 2) m̄` to first order
    (`vision/photometric/fitting/plane.py`); α and λ follow from all markers by least squares without weights,
    since corners come without covariances. Forward, z = -i of the marker, is then along `-i (m - k)`. Fewer
    than `TILT_MIN_MARKERS` markers are taken as seen from straight above.
    """
    squares = fit_squares(to_complex(corners_px))
    if len(corners_px) < TILT_MIN_MARKERS:
        return squares.headings_rad()
    away = (squares.centers - squares.centers.mean()) / np.abs(squares.similarities).max()
    design = squeeze_design_matrix(away)
    relative = squares.anisotropies / squares.similarities.conj()
    squeezes = design @ np.linalg.lstsq(design, relative, rcond=None)[0] * squares.similarities.conj()
    return np.asarray(np.angle(-1j * (squares.similarities - squeezes)))


def _largest_of_each(ids: IntArray, corners: Array) -> tuple[IntArray, Array]:
    """Each id once, ascending, with the largest quadrilateral found for it."""
    order = np.lexsort((-pose_of_corners(corners)[2], ids))
    unique, first = np.unique(ids[order], return_index=True)
    return unique, corners[order[first]]


class _OpenCV:
    """`cv2.aruco.ArucoDetector` at its default parameters but for the refinement."""

    def __init__(self, dictionary: str, refinement: int) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = refinement
        parameters.markerBorderBits = border_cells(dictionary)
        self._detector = cv2.aruco.ArucoDetector(load_dictionary(dictionary), parameters)

    def find(self, image: npt.NDArray[np.uint8], *, corrected: bool) -> tuple[IntArray, Array]:
        return opencv_corners(self._detector, image)


@cache
def _apriltag_library_detector(family: str) -> Any:
    """The library's detector, one for each family and never freed.

    pupil-apriltags frees a family before the detector that refers to it, which crashes the interpreter.
    """
    try:
        library: Any = import_module("pupil_apriltags")
    except ImportError:
        raise InputError(
            "detector apriltag3", "pupil-apriltags is not installed", "pip install skyherd[peers]"
        ) from None

    class Kept(library.Detector):  # type: ignore[misc]
        def __del__(self) -> None:
            """Leave the memory to the end of the process."""

    return Kept(families=family, nthreads=1, quad_decimate=1.0)


class _AprilTag3:
    """AprilTag 3 through pupil-apriltags, at full resolution: its default halves the image first."""

    def __init__(self, dictionary: str) -> None:
        if dictionary not in APRILTAG_FAMILIES:
            raise InputError(
                "detector apriltag3", f"does not know {dictionary}", f"one of {', '.join(APRILTAG_FAMILIES)}"
            )
        self._detector = _apriltag_library_detector(APRILTAG_FAMILIES[dictionary])

    def find(self, image: npt.NDArray[np.uint8], *, corrected: bool) -> tuple[IntArray, Array]:
        tags = self._detector.detect(image)
        corners = np.array([tag.corners for tag in tags], dtype=float).reshape(-1, 4, 2)
        order = OPENCV_CORNERS if corrected else APRILTAG_CORNERS
        return np.array([tag.tag_id for tag in tags], dtype=np.int64), corners[:, order]


class _Locus:
    """locus-tag with its standard profile, on one thread."""

    def __init__(self, dictionary: str) -> None:
        where = "detector locus-tag"
        if dictionary not in LOCUS_FAMILIES:
            raise InputError(where, f"does not know {dictionary}", f"one of {', '.join(LOCUS_FAMILIES)}")
        try:
            library: Any = import_module("locus")
        except ImportError:
            raise InputError(where, "locus-tag is not installed", "pip install skyherd[peers]") from None
        family = getattr(library.TagFamily, LOCUS_FAMILIES[dictionary])
        self._detector = library.Detector(families=[family], threads=1)

    def find(self, image: npt.NDArray[np.uint8], *, corrected: bool) -> tuple[IntArray, Array]:
        found = self._detector.detect(np.ascontiguousarray(image))
        return found.ids.astype(np.int64), found.corners.astype(float).reshape(-1, 4, 2)


_OTHERS: dict[str, Callable[[str], _Finder]] = {"apriltag3": _AprilTag3, "locus-tag": _Locus}
"""Peers of other libraries than OpenCV, by name."""
