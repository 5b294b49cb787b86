"""Wrappers of other libraries' detectors: `cv2.aruco`, AprilTag 3, locus-tag and NAPA.

They run at the defaults of their libraries. Constant errors are subtracted unless `corrected=False`:

- **Pixel centre.** OpenCV's APRILTAG refinement has an offset of +0.46 px in u and v, AprilTag 3 and
  locus-tag of +0.50 px.
- **Side.** OpenCV underestimates it by 0.5 to 1.15 px, except with the APRILTAG refinement.
- **Corner order.** AprilTag's corners run in the opposite direction to OpenCV's, and its tags are rotated by
  180 degrees. The corners of locus-tag and NAPA have OpenCV's order in all families.

`benchmarks/peer_biases.py --write` measures the first two into `peer_biases.toml`. The centre is the mean of
the corners. The heading is that of the nearest square in the common plane of the image's markers
(`headings_in_plane`). These libraries report no covariances, so covariances are zero, which means unknown.
"""

import warnings
from collections.abc import Callable, Mapping
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
from skyherd.vision.photometric.fitting.plane import anisotropy_design_matrix

REFINEMENTS = {
    "opencv": cv2.aruco.CORNER_REFINE_NONE,
    "opencv-subpix": cv2.aruco.CORNER_REFINE_SUBPIX,
    "opencv-contour": cv2.aruco.CORNER_REFINE_CONTOUR,
    "opencv-apriltag": cv2.aruco.CORNER_REFINE_APRILTAG,
}
"""Corner refinement of each `cv2.aruco` detector, by name; all other parameters are OpenCV's defaults."""

APRILTAG_FAMILIES = {"APRILTAG_16h5": "tag16h5", "APRILTAG_25h9": "tag25h9", "APRILTAG_36h11": "tag36h11"}
"""Names of the OpenCV dictionaries that AprilTag 3 supports, in pupil-apriltags and NAPA."""

APRILTAG_CORNERS, OPENCV_CORNERS = [3, 2, 1, 0], [1, 0, 3, 2]
"""Permutations of AprilTag's corners to clockwise order, from the tag's own top left and from OpenCV's
corner 0."""

LOCUS_FAMILIES = {
    "4X4_50": "ArUco4x4_50",
    "4X4_100": "ArUco4x4_100",
    "6X6_250": "ArUco6x6_250",
    "ARUCO_MIP_36h12": "ArUcoMip36h12",
    "APRILTAG_16h5": "AprilTag16h5",
    "APRILTAG_36h11": "AprilTag36h11",
}
"""Names in locus-tag of the dictionaries that it supports."""

NAPA_MIN_SIDE_PX, NAPA_MAX_TAGS = 8, 1024
"""Smallest side that NAPA searches for, px, and most tags of an image. Chosen: the smallest side that it
accepts, since its default of 32 excludes most markers of the benchmarks."""

TILT_MIN_MARKERS = 3
"""Smallest number of markers for an estimate of the tilt. Derived: the anisotropies of two markers determine
the plane's unknowns without redundancy."""


class _Finder(Protocol):
    def find(self, image: npt.NDArray[np.uint8], *, corrected: bool) -> tuple[IntArray, Array]:
        """Return the ids (K,), possibly repeated, and the corners (K, 4, 2), px."""
        ...


class PeerDetector:
    """Detector of another library; implements `skyherd.vision.Detector`.

    If an id is detected several times, the largest quadrilateral is reported. Covariances are zero, which
    means unknown. The detector keeps no state between images.

    Args:
        name: one of `peer_names()`.
        dictionary: name of the marker dictionary.
        corrected: whether to subtract constant biases and to reorder corners to the package's convention.

    Raises:
        InputError: the name or dictionary is unknown, the library does not support the dictionary, or the
            library is not installed.
    """

    def __init__(self, name: str, dictionary: str, *, corrected: bool = True) -> None:
        if name not in (known := (*REFINEMENTS, *_OTHERS)):
            raise InputError("PeerDetector: name", shown(name), f"one of {', '.join(known)}")
        self.name, self.corrected = name, corrected
        self._finder: _Finder = (
            _OpenCV(dictionary, REFINEMENTS[name]) if name in REFINEMENTS else _OTHERS[name](dictionary)
        )

    def detect(self, image: npt.NDArray[np.uint8], *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Return the markers in a grey image (height, width), uint8, in ascending order of id.

        Raises:
            InputError: the image is not a grey image of uint8.
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
        """Return ids (K,), possibly repeated, and corners (K, 4, 2), px, of all detections in an image.

        The corners have the same corrections as in `detect`. Quadrilaterals of zero area are left out.

        Raises:
            InputError: the image is not a grey image of uint8.
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
    """Return the names of the wrapped detectors, including those whose library is not installed."""
    return [*REFINEMENTS, *_OTHERS]


def headings_in_plane(corners_px: Array) -> Array:
    """Return headings (N,), rad, of markers with corners (N, 4, 2) in one plane, which may be tilted.

    Under tilt, a marker at p with similarity m has the anisotropy `k = (α - p λ / 2) m̄` to first order
    (`vision/photometric/fitting/plane.py`). α and λ are estimated from all markers by unweighted least
    squares, because the corners have no covariances. With fewer than `TILT_MIN_MARKERS` markers, no tilt is
    assumed.
    """
    squares = fit_squares(to_complex(corners_px))
    if len(corners_px) < TILT_MIN_MARKERS:
        return squares.headings_rad()
    away = (squares.centers - squares.centers.mean()) / np.abs(squares.similarities).max()
    design = anisotropy_design_matrix(away)
    relative = squares.anisotropies / squares.similarities.conj()
    anisotropies = design @ np.linalg.lstsq(design, relative, rcond=None)[0] * squares.similarities.conj()
    # The forward axis of a marker, z = -i, maps to -i (m - k).
    return np.asarray(np.angle(-1j * (squares.similarities - anisotropies)))


def _largest_of_each(ids: IntArray, corners: Array) -> tuple[IntArray, Array]:
    """Return unique ids, ascending, each with its largest quadrilateral."""
    order = np.lexsort((-pose_of_corners(corners)[2], ids))
    unique, first = np.unique(ids[order], return_index=True)
    return unique, corners[order[first]]


class _OpenCV:
    """`cv2.aruco.ArucoDetector` with default parameters, except for the refinement and the border."""

    def __init__(self, dictionary: str, refinement: int) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = refinement
        parameters.markerBorderBits = border_cells(dictionary)
        self._detector = cv2.aruco.ArucoDetector(load_dictionary(dictionary), parameters)

    def find(self, image: npt.NDArray[np.uint8], *, corrected: bool) -> tuple[IntArray, Array]:
        return opencv_corners(self._detector, image)


def _family(detector: str, families: Mapping[str, str], dictionary: str) -> str:
    """Return a library's name of a dictionary; raise InputError if it does not know it."""
    if dictionary not in families:
        raise InputError(
            f"detector {detector}", f"does not know {dictionary}", f"one of {', '.join(families)}"
        )
    return families[dictionary]


def _library(detector: str, module: str, package: str, requirement: str) -> Any:
    """Return the module of a detector's library; raise InputError if it is not installed."""
    try:
        return import_module(module)
    except ImportError:
        what = f"{package} is not installed"
        raise InputError(f"detector {detector}", what, f"pip install {requirement}") from None


@cache
def _apriltag_library_detector(family: str) -> Any:
    """Return the library's detector for a family; it is created once and never freed.

    pupil-apriltags frees a family before the detector that refers to it, which crashes the interpreter.
    """
    library: Any = _library("apriltag3", "pupil_apriltags", "pupil-apriltags", "skyherd[peers]")

    class Kept(library.Detector):  # type: ignore[misc]
        def __del__(self) -> None:
            """Do not free the memory before the process ends."""

    return Kept(families=family, nthreads=1, quad_decimate=1.0)


class _AprilTag3:
    """AprilTag 3 by pupil-apriltags, at full resolution; the library's default halves the image."""

    def __init__(self, dictionary: str) -> None:
        self._detector = _apriltag_library_detector(_family("apriltag3", APRILTAG_FAMILIES, dictionary))

    def find(self, image: npt.NDArray[np.uint8], *, corrected: bool) -> tuple[IntArray, Array]:
        tags = self._detector.detect(image)
        corners = np.array([tag.corners for tag in tags], dtype=float).reshape(-1, 4, 2)
        order = OPENCV_CORNERS if corrected else APRILTAG_CORNERS
        return np.array([tag.tag_id for tag in tags], dtype=np.int64), corners[:, order]


class _Locus:
    """locus-tag with its standard profile and one thread."""

    def __init__(self, dictionary: str) -> None:
        name = _family("locus-tag", LOCUS_FAMILIES, dictionary)
        library = _library("locus-tag", "locus", "locus-tag", "skyherd[peers]")
        family = getattr(library.TagFamily, name)
        self._detector = library.Detector(families=[family], threads=1)

    def find(self, image: npt.NDArray[np.uint8], *, corrected: bool) -> tuple[IntArray, Array]:
        found = self._detector.detect(np.ascontiguousarray(image))
        return found.ids.astype(np.int64), found.corners.astype(float).reshape(-1, 4, 2)


class _Napa:
    """NAPA (`napa-vision`). Its licence excludes commercial use, so no extra installs it."""

    def __init__(self, dictionary: str) -> None:
        family = _family("napa", APRILTAG_FAMILIES, dictionary)
        library = _library("napa", "napa_vision", "napa-vision", "napa-vision")
        options = {"min_tag_px": NAPA_MIN_SIDE_PX, "max_detections": NAPA_MAX_TAGS}
        with warnings.catch_warnings():
            # Version 0.4.1 makes NumPy warn of the sizes of its ctypes structures.
            warnings.simplefilter("ignore", RuntimeWarning)
            self._detector = library.NapaDetector(family=family, **options)

    def find(self, image: npt.NDArray[np.uint8], *, corrected: bool) -> tuple[IntArray, Array]:
        tags = self._detector.detect(np.ascontiguousarray(image))
        corners = np.array([tag.corners for tag in tags], dtype=float).reshape(-1, 4, 2)
        return np.array([tag.tag_id for tag in tags], dtype=np.int64), corners


_OTHERS: dict[str, Callable[[str], _Finder]] = {
    "apriltag3": _AprilTag3,
    "locus-tag": _Locus,
    "napa": _Napa,
}
"""Wrappers of libraries other than OpenCV, by detector name."""
