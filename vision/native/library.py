"""Typed functions of the compiled library of vision, which check their arguments."""

import ctypes
import threading
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.geometry import Array, ComplexArray, Image, IntArray
from skyherd.native.loading import declare, library_of

PIXELS_PER_QUAD = 8
"""Pixels of an image for each quadrilateral that the result has room for. Derived: the boundary of a region
that counts has 20 points, and visits a pixel at most twice along a line of one pixel."""

UNKNOWNS, COLUMNS = 15, 16
"""Unknowns of a marker, and columns of its pixels: those of the model, and the pixels' own values."""

MAX_SECOND_DIFFERENCE = 4 * 255
"""Largest second difference of grey levels. Derived."""

MARKER = np.dtype(
    [
        ("center", complex),
        ("x_axis", complex),
        ("y_axis", complex),
        ("perspective", complex),
        ("keystone", complex),
        ("anisotropy", complex),
        ("limit", float),
        ("strip", float),
        ("height_px", float),
        ("sigma", float),
        ("black_ratio", float),
        ("half_card", float),
        ("x_stretch", float),
        ("y_stretch", float),
    ]
)
"""Record of a marker, as `Marker` in `fit.h`; lengths are in marker sides unless a unit is given.

- `center`, px, and the axes X and Y and the `perspective`, 1/px, of `LocalHomographies.axes`;
- `keystone`, by how much the marker's image shrinks towards its points, and `anisotropy`, by how much round
  blur differs along its directions (`LocalHomographies.blur_anisotropies`); both are 0 where blur is drawn as
  if the marker were seen from straight above;
- `limit`, up to which marker coordinates pixels are read; `strip`, the same for the affine part of the
  homography, wide enough for the perspective; `height_px`, half the height of the strips' common part;
- `sigma`, the blur's standard deviation, and its standard deviations along x and y over `sigma`;
- `black_ratio`, black level over contrast;
- `half_card`, the distance of the card's edge from the centre, infinite where no ground is seen.
"""

Floats = npt.NDArray[np.float32]

ERRORS = {
    -1: ("image", "an invalid size", "even sides, 2**28 pixels at most"),
    -2: ("search", "invalid parameters", "windows of 3, 5, 9 and 21 px"),
    -3: ("image", "too many regions", "fewer regions in an image"),
    -4: ("markers", "a size or index out of range", "ascending bounds, pixels of the image, 1 to 20 cells"),
    -5: ("markers", "not enough memory", "fewer pixels"),
}
"""Negative results of the library: where, the problem, and what is allowed."""


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


class _Rows(ctypes.Structure):
    """Pixels of markers; `MarkerRows` in `fit.h` has the same fields."""

    _fields_ = (
        ("bounds", ctypes.c_void_p),
        ("places", ctypes.c_void_p),
        ("pixels", ctypes.c_void_p),
        ("columns", ctypes.c_void_p),
        ("count", ctypes.c_int64),
        ("rows", ctypes.c_int64),
    )


class _Scene(ctypes.Structure):
    """Image and markers; `Scene` in `fit.h` has the same fields."""

    _fields_ = (
        ("image", ctypes.c_void_p),
        ("markers", ctypes.c_void_p),
        ("cells", ctypes.c_void_p),
        ("height", ctypes.c_int64),
        ("width", ctypes.c_int64),
        ("n", ctypes.c_int32),
        ("texture_square", ctypes.c_float),
    )


@dataclass(frozen=True)
class MarkerRows:
    """The pixels of N markers, and the model's columns at them.

    Attributes:
        bounds: (N + 1,) marker k has the rows from `bounds[k]` to `bounds[k + 1]`.
        places: (P, 2) marker coordinates x and y, in sides.
        pixels: (P, 2) lines v and columns u in the image.
        columns: (P, 16) the model's columns and the pixels less 128, times the pixels' weights.
    """

    bounds: IntArray
    places: Floats
    pixels: npt.NDArray[np.int32]
    columns: Floats

    def structure(self, first: int = 0, end: int | None = None) -> _Rows:
        """Return the structure of the markers from `first` to `end`, which is valid as long as the arrays.

        Raises:
            InputError: an array has another type, shape or memory layout.
        """
        rows = len(self.columns)
        return _Rows(
            _address("bounds", self.bounds, np.int64, (self.bounds.size,)) + 8 * first,
            _address("places", self.places, np.float32, (rows, 2)),
            _address("pixels", self.pixels, np.int32, (rows, 2)),
            _address("columns", self.columns, np.float32, (rows, COLUMNS)),
            (self.bounds.size - 1 if end is None else end) - first,
            rows,
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

    def list_pixels(self, markers: npt.NDArray[np.void], shape: tuple[int, int]) -> MarkerRows:
        """Return the pixels of N markers (`MARKER`) in an image of a shape, with columns not filled in.

        Raises:
            InputError: `markers` has another type, shape or memory layout.
        """
        given = _address("markers", markers, MARKER, (markers.size,)), markers.size, *shape
        room = self.functions.count_pixels(*given)
        bounds, places = np.empty(markers.size + 1, dtype=np.int64), np.empty((room, 2), dtype=np.float32)
        pixels = np.empty((room, 2), dtype=np.int32)
        results = bounds.ctypes.data, places.ctypes.data, pixels.ctypes.data
        rows = _check(self.functions.list_pixels(*given, *results, room))
        return MarkerRows(bounds, places[:rows], pixels[:rows], np.empty((rows, COLUMNS), dtype=np.float32))

    def fill_round(
        self,
        image: Image,
        markers: npt.NDArray[np.void],
        cells: Floats,
        texture: float,
        rows: MarkerRows,
        first: int = 0,
        end: int | None = None,
    ) -> None:
        """Fill in the columns of the markers from `first` to `end`, under blur that is round in the marker.

        Args:
            image: grey, (height, width).
            markers: (N,) of `MARKER`.
            cells: (N, n + 2, n + 2) 1 where a cell is black, 0 where it is white and on the ground around.
            texture: standard deviation of the ground's texture over that of the noise.
            rows: of the N markers, whose columns are written.
            first: index of the first marker.
            end: index behind the last one; N if left out.

        Raises:
            InputError: an argument has another type, shape or memory layout, or a size beyond its limit.
        """
        scene = _scene(image, markers, cells, texture, first)
        _check(self.functions.fill_round(scene, rows.structure(first, end)))

    def fill_elliptic(
        self,
        image: Image,
        markers: npt.NDArray[np.void],
        blurs: Array,
        cells: Floats,
        texture: float,
        rows: MarkerRows,
        bends: Floats,
        first: int = 0,
        end: int | None = None,
    ) -> None:
        """Fill in the columns of markers under blur that is any ellipse; otherwise as `fill_round`.

        Args:
            image: as there.
            markers: as there; `sigma`, `anisotropy` and the stretches are not used.
            blurs: (N, 6) of `blur_ellipses.blur_tables`: variances along x and y and covariance of the blur,
                in sides squared, and their changes with the logarithm of the blur.
            cells: as there.
            texture: as there.
            rows: as there.
            bends: (P, 3) result: T_xx, T_xy and T_yy, times the pixels' weights.
            first: as there.
            end: as there.

        Raises:
            InputError: as there.
        """
        scene = _scene(image, markers, cells, texture, first)
        tables = _address("blurs", blurs, np.float64, (markers.size, 6)) + 48 * first
        written = _address("bends", bends, np.float32, (len(rows.columns), 3))
        _check(self.functions.fill_elliptic(scene, rows.structure(first, end), tables, written))

    def gram_matrices(self, rows: MarkerRows) -> Floats:
        """Return the inner products (N, 16, 16) of the weighted columns.

        Raises:
            InputError: an array of `rows` has another type, shape or memory layout.
        """
        grams = np.empty((rows.bounds.size - 1, COLUMNS, COLUMNS), dtype=np.float32)
        _check(self.functions.gram_matrices(rows.structure(), grams.ctypes.data))
        return grams

    def residuals(self, rows: MarkerRows, solutions: Floats) -> Floats:
        """Return the weighted residuals (P,), grey levels, of the model at `solutions` (N, 15).

        Raises:
            InputError: an array has another type, shape or memory layout.
        """
        left = np.zeros(len(rows.columns), dtype=np.float32)
        model = _address("solutions", solutions, np.float32, (rows.bounds.size - 1, UNKNOWNS))
        _check(self.functions.residuals(rows.structure(), model, left.ctypes.data))
        return left

    def cell_sums(
        self, rows: MarkerRows, solutions: Floats, n_cells: int
    ) -> tuple[Array, Array, Array, Array]:
        """Return residuals of the model at `solutions` (N, 15), summed over cells.

        Returns:
            The sums (N, n, n) of residuals, grey levels; the numbers of pixels with a weight, and of all
            pixels (both N, n, n); the largest absolute residuals of a pixel (N,).

        Raises:
            InputError: an array has another type, shape or memory layout, or there are more than 20 cells.
        """
        count = rows.bounds.size - 1
        sums, used, read = np.zeros((3, count, n_cells, n_cells))
        peaks = np.zeros(count)
        model = _address("solutions", solutions, np.float32, (count, UNKNOWNS))
        results = (array.ctypes.data for array in (sums, used, read, peaks))
        _check(self.functions.add_over_cells(rows.structure(), model, n_cells, *results))
        return sums, used, read, peaks

    def squared_box_sums(
        self, rows: MarkerRows, solutions: Floats, influences: Floats, picked: IntArray, box_px: int
    ) -> tuple[Array, Array, IntArray]:
        """Return influences times residuals, summed over boxes of pixels and squared, of some markers.

        Args:
            rows: pixels of N markers.
            solutions: (N, 15) of the model.
            influences: (N, K, 15) by how much each of K quantities changes with the model's columns.
            picked: (Q,) indices of markers.
            box_px: side of the small boxes; large ones have twice as much.

        Returns:
            The sums (Q, K) of squares over all small boxes, and over all large ones. The numbers (Q,) of
            large boxes that have pixels.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is out of range.
        """
        count, quantities = rows.bounds.size - 1, influences.shape[1]
        small, large = np.zeros((2, picked.size, quantities))
        boxes = np.zeros(picked.size, dtype=np.int64)
        given = (
            _address("picked", picked, np.int64, (picked.size,)),
            picked.size,
            _address("solutions", solutions, np.float32, (count, UNKNOWNS)),
            _address("influences", influences, np.float32, (count, quantities, UNKNOWNS)),
        )
        results = (array.ctypes.data for array in (small, large, boxes))
        _check(self.functions.add_over_boxes(rows.structure(), *given, quantities, box_px, *results))
        return small, large, boxes

    def second_differences(self, image: Image, darkest: int, brightest: int) -> IntArray:
        """Return how often each `|I(u - 1) - 2 I(u) + I(u + 1)|` (1021,) occurs along lines of an image.

        Every fourth line and column is read, where I(u) is above `darkest` and below `brightest`.

        Raises:
            InputError: the image has another type, shape or memory layout.
        """
        _check_plane("image", image, None)
        counts = np.empty(MAX_SECOND_DIFFERENCE + 1, dtype=np.int64)
        given = image.ctypes.data, *image.shape, darkest, brightest
        _check(self.functions.count_second_differences(*given, counts.ctypes.data))
        return counts

    def hold_unknowns(
        self,
        values: Array,
        inverse_normals: Array,
        squares: Array,
        unknowns: tuple[int, int],
        at: Array,
        variances: Array,
    ) -> None:
        """Hold two unknowns of N solutions, or one twice, or draw them towards values, in place.

        Args:
            values: (N, 15) solutions, changed.
            inverse_normals: (N, 15, 15), changed.
            squares: (N,) sums of squared residuals, changed.
            unknowns: indices of both; equal if it is one.
            at: (N, 2) values, or (N, 1).
            variances: (N,) of each unknown about its value, in units of the noise's variance; 0 holds it.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is out of range.
        """
        count = len(values)
        solutions = (
            _address("values", values, np.float64, (count, UNKNOWNS)),
            _address("inverse_normals", inverse_normals, np.float64, (count, UNKNOWNS, UNKNOWNS)),
            _address("squares", squares, np.float64, (count,)),
        )
        targets = (
            _address("at", at, np.float64, (count, len(set(unknowns)))),
            _address("variances", variances, np.float64, (count,)),
        )
        _check(self.functions.hold_unknowns(*solutions, count, *unknowns, *targets))

    def fit_plane(
        self,
        points: ComplexArray,
        anisotropies: ComplexArray,
        variances: Array,
        limits: Array,
        max_rounds: int,
    ) -> tuple[complex, complex, bool, ComplexArray]:
        """Return the simplest plane of anisotropies (N,) at image points (N,); see `fitting.plane`.

        Args:
            points: (N,) px from the image's centre.
            anisotropies: (N,) in image axes.
            variances: (N,) of each of the anisotropies' components, of which one at least is finite.
            limits: (4,) `SIGNIFICANT`, `EXCESS`, `CONVERGED` and `PERSPECTIVE_RIDGE` of `plane`.
            max_rounds: largest number of iterations.

        Returns:
            α and λ, whether they explain the anisotropies, and their covariance (2, 2).

        Raises:
            InputError: an argument has another type, shape or memory layout.
        """
        count, plane, covariance = points.size, np.zeros(2, dtype=complex), np.zeros((2, 2), dtype=complex)
        given = (
            _address("points", points, np.complex128, (count,)),
            _address("anisotropies", anisotropies, np.complex128, (count,)),
            _address("variances", variances, np.float64, (count,)),
        )
        limits_there = _address("limits", limits, np.float64, (4,))
        results = plane.ctypes.data, covariance.ctypes.data
        shared = self.functions.fit_plane(*given, count, limits_there, max_rounds, *results)
        return complex(plane[0]), complex(plane[1]), bool(shared), covariance

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
    pointer, size, integer, long = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int32, ctypes.c_int64
    scene, rows = ctypes.POINTER(_Scene), ctypes.POINTER(_Rows)
    parameters = ctypes.POINTER(SearchParameters)
    search = (pointer, pointer, integer, integer, parameters, pointer, size)
    signatures = {
        "search_workspace_bytes": (size, integer, integer),
        "search_mask": (integer, *search, pointer),
        "search_quads": (integer, *search, pointer, pointer, integer),
        "count_pixels": (long, pointer, long, long, long),
        "list_pixels": (long, pointer, long, long, long, pointer, pointer, pointer, long),
        "fill_round": (integer, scene, rows),
        "fill_elliptic": (integer, scene, rows, pointer, pointer),
        "gram_matrices": (integer, rows, pointer),
        "residuals": (integer, rows, pointer, pointer),
        "add_over_cells": (integer, rows, pointer, integer, *(pointer,) * 4),
        "add_over_boxes": (integer, rows, pointer, long, pointer, pointer, integer, integer, *(pointer,) * 3),
        "count_second_differences": (integer, pointer, long, long, integer, integer, pointer),
        "hold_unknowns": (integer, *(pointer,) * 3, long, integer, integer, pointer, pointer),
        "fit_plane": (integer, *(pointer,) * 3, long, pointer, integer, pointer, pointer),
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


def _scene(image: Image, markers: npt.NDArray[np.void], cells: Floats, texture: float, first: int) -> _Scene:
    """Return the structure of an image and of the markers from `first` on, which the arrays keep valid."""
    sides = cells.shape[1]
    return _Scene(
        _address("image", image, np.uint8, image.shape),
        _address("markers", markers, MARKER, (markers.size,)) + MARKER.itemsize * first,
        _address("cells", cells, np.float32, (markers.size, sides, sides)) + 4 * sides**2 * first,
        *image.shape,
        sides - 2,
        texture * texture,
    )


def _address(where: str, array: npt.NDArray[np.generic], dtype: npt.DTypeLike, shape: tuple[int, ...]) -> int:
    """Return the address of a contiguous array of one type and shape.

    Raises:
        InputError: it has another type, shape or memory layout.
    """
    if array.dtype != dtype or array.shape != shape or not array.flags.c_contiguous:
        raise InputError(where, f"shape {array.shape}, {array.dtype}", f"contiguous, {shape}, {dtype}")
    return int(array.ctypes.data)


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
        raise InputError(*ERRORS[result])
    return result
