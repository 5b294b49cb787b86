"""Typed functions of the compiled library of vision, which check their arguments."""

import ctypes
import threading
from dataclasses import dataclass
from functools import cache

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array, Image, IntArray
from skyherd.native.loading import declare, library_of

PIXELS_PER_QUAD = 8
"""Pixels of an image for each quadrilateral that the result has room for. Derived: the boundary of a region
that counts has 20 points, and visits a pixel at most twice along a line of one pixel."""

ERRORS = {
    -1: ("an invalid size", "even sides, 2**28 pixels at most"),
    -2: ("invalid parameters", "windows of 3, 5, 9 and 21 px"),
    -3: ("too many regions", "fewer regions in an image"),
}
"""Negative results of the library: the problem and the allowed values."""


class SearchParameters(ctypes.Structure):
    """Parameters of the search; `search.h` declares the same fields."""

    _fields_ = (
        ("growth_px", ctypes.c_double),
        ("eroded_px", ctypes.c_double),
        ("min_area_px2", ctypes.c_double),
        ("min_compactness", ctypes.c_double),
        ("rounded_share", ctypes.c_double),
        ("side_end_weight", ctypes.c_double),
        ("min_length_px", ctypes.c_double),
        ("min_crossing", ctypes.c_double),
        ("min_side_px", ctypes.c_double),
        ("max_side_ratio", ctypes.c_double),
        ("max_area_mismatch", ctypes.c_double),
        ("darker", ctypes.c_int32),
        ("min_points", ctypes.c_int32),
        ("smoothing_px", ctypes.c_int32),
        ("sharpening_px", ctypes.c_int32),
        ("small_window_px", ctypes.c_int32),
        ("large_window_px", ctypes.c_int32),
        ("first_erosions", ctypes.c_int32),
        ("last_erosions", ctypes.c_int32),
    )


class _Workspaces(threading.local):
    """Memory for the library, one array for each thread, kept between calls."""

    memory = np.zeros(0, dtype=np.uint8)

    def of(self, size: int) -> Image:
        """Return at least `size` bytes. Pages that the library does not write take no memory."""
        if self.memory.size < size:
            self.memory = np.empty(size, dtype=np.uint8)
        return self.memory


_workspaces = _Workspaces()


@dataclass(frozen=True)
class Library:
    """One loaded build of the library.

    Attributes:
        functions: the shared library, its functions with argument and result types.
    """

    functions: ctypes.CDLL

    def dark_mask(self, image: Image, places: Image, parameters: SearchParameters) -> Image:
        """Return the dark pixels of an image within its places as 255.

        Args:
            image: grey, (height, width), even sides.
            places: (height / 2, width / 2), 255 where the image is searched.
            parameters: of the search.

        Raises:
            InputError: an argument has another type, shape or memory layout, or an invalid parameter.
        """
        arguments = self._search_arguments(image, places, parameters)
        dark = np.empty(image.shape, dtype=np.uint8)
        _check(self.functions.search_mask(*arguments, dark.ctypes.data))
        return dark

    def quads(self, image: Image, places: Image, parameters: SearchParameters) -> tuple[Array, IntArray]:
        """Return the dark quadrilaterals of an image within its places.

        Args:
            image: grey, (height, width), even sides.
            places: (height / 2, width / 2), 255 where the image is searched.
            parameters: of the search.

        Returns:
            Corners (N, 4, 2), px, clockwise in the image, and the column (N,) of a pixel of each region.

        Raises:
            InputError: an argument has another type, shape or memory layout, or an invalid parameter.
        """
        arguments = self._search_arguments(image, places, parameters)
        room = image.size // PIXELS_PER_QUAD * (parameters.last_erosions + 1) + 1
        corners, columns = np.empty((room, 4, 2)), np.empty(room, dtype=np.int32)
        found = _check(
            self.functions.search_quads(*arguments, corners.ctypes.data, columns.ctypes.data, room)
        )
        return corners[:found].copy(), columns[:found].astype(np.int64)

    def _search_arguments(
        self, image: Image, places: Image, parameters: SearchParameters
    ) -> tuple[object, ...]:
        """Return the arguments that both functions of the search begin with."""
        _check_plane("image", image, None)
        height, width = image.shape
        size = int(self.functions.search_workspace_bytes(width, height))
        if not size:
            _check(-1)
        _check_plane("places", places, (height // 2, width // 2))
        memory = _workspaces.of(size)
        pointers = image.ctypes.data, places.ctypes.data
        return *pointers, width, height, ctypes.byref(parameters), memory.ctypes.data, memory.size


def declared(functions: ctypes.CDLL) -> Library:
    """Return a loaded library with the types of its functions declared."""
    pointer, size, integer = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int32
    parameters = ctypes.POINTER(SearchParameters)
    search = (pointer, pointer, integer, integer, parameters, pointer, size)
    signatures = {
        "search_workspace_bytes": (size, integer, integer),
        "search_mask": (integer, *search, pointer),
        "search_quads": (integer, *search, pointer, pointer, integer),
    }
    declare(functions, signatures)
    return Library(functions)


@cache
def library() -> Library:
    """Return the library for this processor.

    Raises:
        NativeLibraryError: it is missing, cannot be loaded, or has been built from other sources.
    """
    return declared(library_of("vision"))


def _check_plane(where: str, plane: object, shape: tuple[int, int] | None) -> None:
    """Check that a value is a contiguous plane of uint8, of one shape if it is given.

    Raises:
        InputError: it is not.
    """
    allowed = f"contiguous, {shape or '(height, width)'}, uint8"
    if not isinstance(plane, np.ndarray):
        raise InputError(where, f"a {type(plane).__name__}", allowed)
    valid = plane.ndim == 2 and plane.dtype == np.uint8 and plane.flags.c_contiguous
    if not valid or (shape is not None and plane.shape != shape):
        raise InputError(where, f"shape {plane.shape}, {plane.dtype}", allowed)


def _check(result: int) -> int:
    """Return a result of the library that is no error.

    Raises:
        InputError: the library rejected an argument.
    """
    if result < 0:
        raise InputError("image", *ERRORS[result])
    return result
