"""Square markers: dictionaries, cells, and pose from corners.

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
from skyherd.messages.checks import check_kind
from skyherd.text import one_of

QUIET_ZONE_CELLS = 1.0
"""Width of the white card around the black square, in cells. *Chosen*: the minimum of detectors; twice as
wide costs a quarter more room on the robot."""


BORDER_MARK, MAX_BORDER_BITS = "@", 3
"""Separator of a dictionary's name and its border width, and the maximum width, in cells. *Chosen*: boards
have one or two cells; the separator occurs in no name."""

OPENCV_PREFIX = "DICT_"
"""What the names of OpenCV's dictionaries begin with. *Defined* by OpenCV."""

DISTANCE_SAMPLE = 200
"""Number of markers whose distances to all others are computed. Chosen: at most a second of work."""


def dictionary_names() -> list[str]:
    """List the names of OpenCV's dictionaries, without `DICT_`, and of the generated ones.

    Of names that differ in capitals alone, such as `APRILTAG_16h5`, the one in small letters is listed.
    """
    of_opencv = (name for name in dir(cv2.aruco) if name.startswith(OPENCV_PREFIX))
    names = sorted([*CODES, *(name.removeprefix(OPENCV_PREFIX) for name in of_opencv)])
    return sorted({name.upper(): name for name in names}.values())


@cache
def canonical_name(name: str) -> str:
    """Return skyherd's name of a dictionary that may be named as in OpenCV: `4X4_50` for `DICT_4X4_50`.

    Case does not count. A border after the name is kept. An unknown name is returned unchanged.
    """
    plain, mark, border = name.partition(BORDER_MARK)
    known = {known.upper(): known for known in dictionary_names()}
    return known.get(plain.upper().removeprefix(OPENCV_PREFIX), plain) + mark + border


def with_border(name: str, border_bits: int) -> str:
    """Return the name of a dictionary with a black border of given width: `4X4_50@2` for two cells.

    Camera calibration boards often have two. All functions here accept such names. Without the suffix the
    border is one cell wide, as OpenCV and AprilTag draw it.

    Raises:
        InputError: the border is not of 1 to `MAX_BORDER_BITS` cells, or the name has one already.
    """
    name = canonical_name(name)
    whole = isinstance(border_bits, int | np.integer)
    if not (whole and 1 <= border_bits <= MAX_BORDER_BITS):
        raise InputError("border bits", f"{border_bits!r}", f"a whole number from 1 to {MAX_BORDER_BITS}")
    if border_bits == 1:
        return name
    if BORDER_MARK in name:
        raise InputError("dictionary", f"{name} names its border already", "one of the two")
    return f"{name}{BORDER_MARK}{border_bits}"


@cache
def border_cells(name: str) -> int:
    """Return the width of the black border of a dictionary's markers, in cells; see `with_border`.

    Raises:
        InputError: the suffix of the dictionary's name is not a valid width.
    """
    check_kind("dictionary", name, str, "a name such as 4X4_50")
    _, mark, width = name.partition(BORDER_MARK)
    if not mark:
        return 1
    if width not in map(str, range(1, MAX_BORDER_BITS + 1)):
        raise InputError(
            "dictionary", f"{name!r}", f"a border of 1 to {MAX_BORDER_BITS} cells after {BORDER_MARK}"
        )
    return int(width)


@cache
def load_dictionary(name: str) -> cv2.aruco.Dictionary:
    """Load a dictionary by a name such as `4X4_50`; `border_cells` handles a border suffix.

    Raises:
        InputError: the name is unknown; the error lists the known ones.
    """
    border_cells(name)
    name = canonical_name(name).partition(BORDER_MARK)[0]
    if name in CODES:
        return _generate(name)
    if name not in dictionary_names():
        raise InputError(
            "dictionary",
            f"no dictionary {name!r}",
            "the name that `skyherd detect --dictionary auto` finds"
            if name == "auto"
            else one_of(name.removeprefix(OPENCV_PREFIX), dictionary_names()),
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"{OPENCV_PREFIX}{name}"))


def _generate(name: str) -> cv2.aruco.Dictionary:
    """Return a generated dictionary in OpenCV's form; it corrects half the distance, rounded down."""
    code = CODES[name]
    rows = [cv2.aruco.Dictionary.getByteListFromBits(bits) for bits in code_bits(code).astype(np.uint8)]
    return cv2.aruco.Dictionary(np.concatenate(rows), code.cells, (code.distance - 1) // 2)


def dictionary_size(name: str) -> int:
    """Return the number of markers in a dictionary."""
    return int(load_dictionary(name).bytesList.shape[0])


@cache
def cells_per_side(name: str) -> int:
    """Return the number of cells along a marker's side, including its black border."""
    return int(load_dictionary(name).markerSize) + 2 * border_cells(name)


@cache
def marker_cells(name: str, marker_id: int) -> npt.NDArray[np.bool_]:
    """Return the white cells (n, n) of one marker with its border, read-only; row 0 is the front edge.

    Raises:
        InputError: the dictionary has no marker of that id.
    """
    if not 0 <= marker_id < dictionary_size(name):
        raise InputError("marker id", f"{marker_id} is not in {name}", f"0 to {dictionary_size(name) - 1}")
    return np.asarray(all_marker_cells(name)[marker_id], dtype=bool)


@cache
def all_marker_cells(name: str) -> npt.NDArray[np.bool_]:
    """Return the white cells (D, n, n) of all markers of a dictionary with their borders, read-only.

    OpenCV keeps the bits of a marker in four turns, one after the other. They run row by row, eight to a
    byte; the last byte has the rest in its low bits.

    Raises:
        InputError: there is no such dictionary.
    """
    dictionary, border = load_dictionary(name), border_cells(name)
    count, per_side = dictionary_size(name), int(dictionary.markerSize)
    whole, rest = divmod(per_side**2, 8)
    packed = np.asarray(dictionary.bytesList, dtype=np.uint8).reshape(count, 4, -1)[:, 0]
    bits = np.unpackbits(packed[:, :whole], axis=1)
    if rest:
        bits = np.hstack([bits, np.unpackbits(packed[:, whole:], axis=1)[:, -rest:]])
    cells = np.zeros((count, per_side + 2 * border, per_side + 2 * border), dtype=bool)
    cells[:, border:-border, border:-border] = bits.reshape(count, per_side, per_side)
    cells.setflags(write=False)
    return cells


@cache
def mirror_symmetric_ids(name: str) -> frozenset[int]:
    """Return the markers of a dictionary whose mirror image is one of its markers, in any quarter turn."""
    cells = all_marker_cells(name)
    known = {np.rot90(marker, turn).tobytes() for marker in cells for turn in range(4)}
    return frozenset(row for row, marker in enumerate(cells) if marker[:, ::-1].tobytes() in known)


@cache
def code_distance(name: str) -> int:
    """Return the minimum Hamming distance between two markers of a dictionary at any rotation.

    In dictionaries of more than `DISTANCE_SAMPLE` markers, only the first ones are compared with all.
    """
    border = border_cells(name)
    bits = all_marker_cells(name)[:, border:-border, border:-border]
    turned = np.concatenate([np.rot90(bits, turn, axes=(1, 2)) for turn in range(4)]).reshape(
        4 * len(bits), -1
    )
    signs, some = 2.0 * turned - 1, min(len(bits), DISTANCE_SAMPLE)
    agreement = (signs[:some] @ signs.T).astype(np.float32)
    agreement[np.arange(some), np.arange(some)] = -np.inf
    return int((turned.shape[1] - agreement.max()) / 2)


def card_side(name: str) -> float:
    """Return the side of the white card, marker and quiet zone, in marker sides."""
    return 1.0 + 2.0 * QUIET_ZONE_CELLS / cells_per_side(name)


def corners_of_pose(centers_px: npt.ArrayLike, headings_rad: npt.ArrayLike, sides_px: npt.ArrayLike) -> Array:
    """Return image corners (N, 4, 2), px, of squares with centres (N, 2), headings and sides (N,)."""
    arms = 1j * np.asarray(sides_px) * np.exp(1j * np.asarray(headings_rad))
    corners = to_complex(centers_px)[:, None] + arms[:, None] * SQUARE_CORNERS
    return np.stack([corners.real, corners.imag], axis=-1)


def pose_of_corners(corners_px: npt.ArrayLike) -> tuple[Array, Array, Array]:
    """Return centres (N, 2), headings (N,) and sides (N,) of the best squares to corners (N, 4, 2).

    The least-squares similarity of the unit square (`skyherd.geometry.fit_squares`): side `|arm|`, heading
    `arg(-i arm)`.
    """
    squares = fit_squares(to_complex(np.asarray(corners_px, dtype=float).reshape(-1, 4, 2)))
    return to_points(squares.centers), squares.headings_rad(), np.abs(squares.similarities)


def headings_of_corners(centers_px: Array, corners_px: Array) -> Array:
    """Return headings (N,) from corners (N, 4, 2): from the centre to the middle of the front edge.

    Unlike `pose_of_corners` this also holds for mirrored markers, which no detector decodes.
    """
    front = to_complex(corners_px[:, :2])
    return np.angle((front[:, 0] + front[:, 1]) / 2 - to_complex(centers_px))


def sides_of_corners(corners_px: Array) -> Array:
    """Return sides (N,), the roots of the areas, from corners (N, 4, 2), also of mirrored markers."""
    corners = to_complex(corners_px)
    diagonals = (corners[:, 2] - corners[:, 0]).conj() * (corners[:, 3] - corners[:, 1])
    return np.asarray(np.sqrt(np.abs(diagonals.imag) / 2))
