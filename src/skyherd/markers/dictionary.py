"""Square markers: dictionaries, cells, and how a marker's corners tell its pose.

A marker of `n` cells a side (bits and black border) is a black square with the bits inside, on a white
card that adds a quiet zone. Its forward direction is from the centre to the middle of the edge between
corners 0 and 1, as OpenCV orders them.
"""

from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.geometry import SQUARE_CORNERS, Array, fit_squares, to_complex, to_points
from skyherd.markers.codes import CODES, code_bits

QUIET_ZONE_CELLS = 1.0
"""Width of the white card around the black square, in cells."""


def dictionary_names() -> list[str]:
    """Names of OpenCV's dictionaries, without their `DICT_` prefix, and of the generated ones."""
    return sorted(
        [*CODES, *(name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_"))]
    )


@cache
def load_dictionary(name: str) -> cv2.aruco.Dictionary:
    """The dictionary of that name, such as `4X4_50`; InputError names those there are."""
    if name in CODES:
        return _generate(name)
    if name not in dictionary_names():
        raise InputError(
            "marker dictionary", f"no dictionary {name!r}", f"one of {', '.join(dictionary_names())}"
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))


def _generate(name: str) -> cv2.aruco.Dictionary:
    """A generated dictionary as OpenCV has them: half the distance, rounded down, can be corrected."""
    code = CODES[name]
    rows = [cv2.aruco.Dictionary.getByteListFromBits(bits) for bits in code_bits(code).astype(np.uint8)]
    return cv2.aruco.Dictionary(np.concatenate(rows), code.cells, (code.distance - 1) // 2)


def dictionary_size(name: str) -> int:
    """Number of markers in a dictionary."""
    return int(load_dictionary(name).bytesList.shape[0])


@cache
def cells_per_side(name: str) -> int:
    """Cells along a marker's side, its black border included."""
    return int(load_dictionary(name).markerSize) + 2


@cache
def marker_cells(name: str, marker_id: int) -> npt.NDArray[np.bool_]:
    """White cells of one marker, (n, n) with its black border; row 0 is the forward edge."""
    if not 0 <= marker_id < dictionary_size(name):
        raise InputError("marker id", f"{marker_id} is not in {name}", f"0 to {dictionary_size(name) - 1}")
    n = cells_per_side(name)
    cells = np.asarray(cv2.aruco.generateImageMarker(load_dictionary(name), marker_id, n)) > 127
    cells.setflags(write=False)
    return cells


def card_side(name: str) -> float:
    """Side of the white card (marker and quiet zone) in marker sides."""
    return 1.0 + 2.0 * QUIET_ZONE_CELLS / cells_per_side(name)


def corners_of_pose(centers_px: npt.ArrayLike, headings_rad: npt.ArrayLike, sides_px: npt.ArrayLike) -> Array:
    """Image corners (N, 4, 2) of squares at centres (N, 2), headings (N,) and sides (N,)."""
    arms = 1j * np.asarray(sides_px) * np.exp(1j * np.asarray(headings_rad))
    corners = to_complex(centers_px)[:, None] + arms[:, None] * SQUARE_CORNERS
    return np.stack([corners.real, corners.imag], axis=-1)


def pose_of_corners(corners_px: npt.ArrayLike) -> tuple[Array, Array, Array]:
    """Centre (N, 2), heading (N,) and side (N,) of the squares nearest to corners (N, 4, 2).

    The least-squares similarity of the unit square (`skyherd.geometry.fit_squares`): side `|arm|`, heading
    `arg(-i arm)`.
    """
    squares = fit_squares(to_complex(np.asarray(corners_px, dtype=float).reshape(-1, 4, 2)))
    return to_points(squares.centers), squares.headings_rad(), np.abs(squares.arms)
