"""Typed functions of the compiled search and of the reading of images, which check their arguments."""

import ctypes
import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, Image, IntArray
from skyherd.native.arguments import address, check, check_plane
from skyherd.native.loading import Signature
from skyherd.vision.native.records import ERRORS, EdgeParameters, Floats, SearchParameters

PIXELS_PER_QUAD = 8
"""Pixels of an image for each quadrilateral that the result has room for. Derived: the boundary of a region
that counts has 20 points, and visits a pixel at most twice along a line of one pixel."""


CODE_STEP = 32
"""Columns of codes are a multiple of this. Derived: two vectors of the widest build, as in `decode.c`."""


@dataclass(frozen=True)
class CodeColumns:
    """Codes stored column by column, so that vectors hold the same cell of many of them.

    Attributes:
        columns: (K, S) cells of the codes; S is a multiple of `CODE_STEP`.
        count: number of codes, in the first columns.
    """

    columns: Floats
    count: int

    @classmethod
    def of(cls, codes: Floats) -> "CodeColumns":
        """Return codes (M, K)."""
        columns = np.zeros((codes.shape[1], -(-len(codes) // CODE_STEP) * CODE_STEP), dtype=np.float32)
        columns[:, : len(codes)] = codes.T
        return cls(columns, len(codes))

    def address(self) -> int:
        """Return the address of the columns."""
        return address("columns", self.columns, np.float32, self.columns.shape)


@dataclass(frozen=True)
class CodeTable:
    """M codes under one blur.

    Attributes:
        columns: standardised brightness of their cells.
        means: (M,) mean darkness, 0 to 1.
        deviations: (M,) standard deviation of the darkness.
    """

    columns: CodeColumns
    means: Array
    deviations: Array

    def structure(self, least: float) -> "CodeTableStructure":
        """Return the table with its least likeness as the library takes it; the arrays keep it valid."""
        count = self.columns.count
        return CodeTableStructure(
            self.columns.address(),
            address("means", self.means, np.float64, (count,)),
            address("deviations", self.deviations, np.float64, (count,)),
            count,
            self.columns.columns.shape[1],
            least,
        )


class CodeTableStructure(ctypes.Structure):
    """Codes under one blur; `CodeTable` in `search.h` has the same fields."""

    _fields_ = (
        ("columns", ctypes.c_void_p),
        ("means", ctypes.c_void_p),
        ("deviations", ctypes.c_void_p),
        ("count", ctypes.c_int64),
        ("stride", ctypes.c_int64),
        ("least", ctypes.c_double),
    )


class DecodeConstants(ctypes.Structure):
    """Limits of the decoding; `search.h` declares the same fields."""

    _fields_ = (("min_deviation", ctypes.c_double), ("min_white", ctypes.c_double))


DECODED = np.dtype([("likeness", float), ("print_contrast", float), ("deviation", float), ("code", np.int64)])
"""Code that a row of cells resembles most, as `Decoded` in `search.h`."""


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
class SearchFunctions:
    """Functions of `search.h` in one loaded build of the library.

    Attributes:
        functions: the shared library, its functions with argument and result types.
    """

    functions: ctypes.CDLL

    def quads(self, image: Image, places: Image, parameters: SearchParameters) -> tuple[Array, IntArray]:
        """Return the dark quadrilaterals of an image, or of the enlarged image, within its places.

        Args:
            image: grey, (height, width), even sides.
            places: (height / 2, width / 2), 255 where the image is searched.
            parameters: of the search; they have the enlargement.

        Returns:
            Corners (N, 4, 2), px of the enlarged image, clockwise, and the column (N,) of a pixel of each
            region.

        Raises:
            InputError: an argument has another type, shape or memory layout, or an invalid parameter.
        """
        arguments = self._search_arguments(image, places, parameters)
        pixels = parameters.enlargement**2 * image.size
        room = pixels // PIXELS_PER_QUAD * (parameters.last_erosions + 1) + 1
        corners, columns = np.empty((room, 4, 2)), np.empty(room, dtype=np.int32)
        results = corners.ctypes.data, columns.ctypes.data, room
        found = check(self.functions.search_quads(*arguments, *results), ERRORS)
        return corners[:found].copy(), columns[:found].astype(np.int64)

    def large_boundaries(self, image: Image, darker: int, min_side_px: int) -> list[npt.NDArray[np.int32]]:
        """Return the outer boundaries (M, 2), px, of large regions that are darker than their surroundings.

        Args:
            image: grey, (height, width), even sides.
            darker: by how many grey levels pixels are below the mean of a window of 21 px.
            min_side_px: smallest width and height of a region, px.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is out of range.
        """
        check_plane("image", image, None)
        (height, width), memory = image.shape, self._search_memory(*image.shape)
        points = np.empty((4 * image.size, 2), dtype=np.int32)
        counts = np.empty(image.size // max(min_side_px, 1) + 1, dtype=np.int32)
        given = image.ctypes.data, width, height, darker, min_side_px, memory.ctypes.data, memory.size
        results = points.ctypes.data, len(points), counts.ctypes.data, counts.size
        found = check(self.functions.search_boundaries(*given, *results), ERRORS)
        ends = np.cumsum(counts[:found])
        return np.split(points[: ends[-1] if found else 0], ends[:-1]) if found else []

    def block_means(self, image: Image, side: int) -> Image:
        """Return the rounded means over blocks of `side` x `side` pixels, 2 or more, of an image.

        Raises:
            InputError: the image has another type, shape or memory layout, or is smaller than a block.
        """
        check_plane("image", image, None)
        (height, width), sums = image.shape, np.empty(image.shape[1], dtype=np.uint16)
        means = np.empty((height // side, width // side), dtype=np.uint8)
        given = image.ctypes.data, width, height, side, sums.ctypes.data
        check(self.functions.block_means(*given, means.ctypes.data), ERRORS)
        return means

    def stretched(self, image: Image, gains: Floats, shifts: Floats, is_sharp: Image) -> tuple[Image, Image]:
        """Return two images of gains times grey levels plus shifts, rounded and within 0 to 255.

        Both are smoothed by a binomial filter of 3 px, the first one only in blocks that are not sharp.

        Args:
            image: grey, (height, width).
            gains: (2, rows, columns) of blocks of 4 x 4 pixels, bilinear between the blocks' centres.
            shifts: (2, rows, columns) grey levels, likewise.
            is_sharp: (rows, columns) 255 where the first image is not smoothed, else 0.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is empty.
        """
        check_plane("image", image, None)
        (height, width), (rows, columns) = image.shape, is_sharp.shape
        blocks = (
            address("gains", gains, np.float32, (2, rows, columns)),
            address("shifts", shifts, np.float32, (2, rows, columns)),
            address("is_sharp", is_sharp, np.uint8, (rows, columns)),
        )
        memory, made = np.empty((10, width), dtype=np.float32), np.empty((2, height, width), dtype=np.uint8)
        given = image.ctypes.data, width, height, *blocks, columns, rows
        check(self.functions.stretch(*given, memory.ctypes.data, made.ctypes.data), ERRORS)
        return made[0], made[1]

    def sampled_squares(self, image: Image, corners_px: Array, at: Array, fine: int) -> Floats:
        """Return grey levels (N, side, side) on a grid within quadrilaterals, each a mean of `fine`² places.

        Args:
            image: grey, (height, width).
            corners_px: (N, 4, 2) images of (0, 0), (1, 0), (1, 1) and (0, 1), px.
            at: (fine * side,) places along either axis of the unit square.
            fine: neighbouring places that count as one along either axis.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is empty.
        """
        check_plane("image", image, None)
        (height, width), side, count = image.shape, at.size // max(fine, 1), len(corners_px)
        levels = np.empty((count, side, side), dtype=np.float32)
        corners = address("corners", corners_px, np.float64, (count, 4, 2))
        places = address("places", at, np.float64, (fine * side,))
        given = image.ctypes.data, width, height, corners, count, places, side, fine
        check(self.functions.sample_squares(*given, levels.ctypes.data), ERRORS)
        return levels

    def decoded(
        self,
        cells: Floats,
        table_of_row: npt.NDArray[np.int32],
        tables: Sequence[CodeTable],
        least: Sequence[float],
        constants: DecodeConstants,
    ) -> npt.NDArray[np.void]:
        """Return the code that each row of cells resembles most, (N,) of `DECODED`.

        Of equally alike codes the first counts.

        Args:
            cells: (N, K) grey levels.
            table_of_row: (N,) number of the table that a row is compared with.
            tables: T of them, of codes of K cells. The last one has strongly blurred codes.
            least: (T,) likeness from which on a row of a table is compared with the last one too. That of
                the last table is the likeness from which on this counts.
            constants: limits.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is empty.
        """
        (rows, count), last = cells.shape, tables[-1].columns.columns.shape[0]
        structures = [table.structure(one) for table, one in zip(tables, least, strict=True)]
        found = np.empty(rows, dtype=DECODED)
        given = (
            address("cells", cells, np.float32, (rows, last)),
            rows,
            count,
            address("table_of_row", table_of_row, np.int32, (rows,)),
            (CodeTableStructure * len(tables))(*structures),
            len(tables),
        )
        check(self.functions.decode_cells(*given, ctypes.byref(constants), found.ctypes.data), ERRORS)
        return found

    def code_products(self, samples: Floats, codes: CodeColumns) -> Floats:
        """Return the inner products (N, M) of rows of samples (N, K) with all codes.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is empty.
        """
        cells, stride = codes.columns.shape
        products = np.empty((len(samples), stride), dtype=np.float32)
        rows = address("samples", samples, np.float32, (len(samples), cells))
        given = rows, len(samples), cells, codes.address(), codes.count, stride
        check(self.functions.code_products(*given, products.ctypes.data), ERRORS)
        return products[:, : codes.count]

    def refined_corners(
        self, image: Image, corners_px: Array, n_cells: int, parameters: EdgeParameters
    ) -> tuple[Array, Array, Array, Array]:
        """Return the corners (N, 4, 2), px, of dark quadrilaterals by the edges of their sides.

        Args:
            image: grey, (height, width).
            corners_px: (N, 4, 2) clockwise in the image.
            n_cells: cells along a marker's side, border included.
            parameters: of the refinement.

        Returns:
            The corners; and (N,) each the standard deviation of an edge about its line, px, the share of
            inliers, and the median brightening along a normal, grey levels.

        Raises:
            InputError: an argument has another type, shape or memory layout, or an invalid parameter.
        """
        check_plane("image", image, None)
        (height, width), count = image.shape, len(corners_px)
        address("corners", corners_px, np.float64, (count, 4, 2))
        refined, (spreads, supports, rises) = corners_px.copy(), np.zeros((3, count))
        given = image.ctypes.data, width, height, count, n_cells, ctypes.byref(parameters)
        results = (array.ctypes.data for array in (refined, spreads, supports, rises))
        check(self.functions.fit_edges(*given, *results), ERRORS)
        return refined, spreads, supports, rises

    def _search_arguments(
        self, image: Image, places: Image, parameters: SearchParameters
    ) -> tuple[object, ...]:
        """Return the arguments that the search begins with."""
        check_plane("image", image, None)
        check_plane("places", places, (image.shape[0] // 2, image.shape[1] // 2))
        height, width = (parameters.enlargement * side for side in image.shape)
        memory = self._search_memory(height, width)
        pointers = image.ctypes.data, places.ctypes.data
        return *pointers, width, height, ctypes.byref(parameters), memory.ctypes.data, memory.size

    def _search_memory(self, height: int, width: int) -> Image:
        """Return the workspace of a search of an image."""
        size = int(self.functions.search_workspace_bytes(width, height))
        return _workspaces.of(size or check(-1, ERRORS))


def search_signatures() -> dict[str, Signature]:
    """Return the types of the functions of `search.h`, by their names."""
    pointer, size, integer, long = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int32, ctypes.c_int64
    search = (pointer, pointer, integer, integer, ctypes.POINTER(SearchParameters), pointer, size)
    boundaries = (pointer, *(integer,) * 4, pointer, size, pointer, long, pointer, integer)
    tables, constants = ctypes.POINTER(CodeTableStructure), ctypes.POINTER(DecodeConstants)
    return {
        "search_workspace_bytes": (size, integer, integer),
        "search_quads": (integer, *search, pointer, pointer, integer),
        "search_boundaries": (integer, *boundaries),
        "block_means": (integer, pointer, *(integer,) * 3, *(pointer,) * 2),
        "stretch": (integer, pointer, *(integer,) * 2, *(pointer,) * 3, *(integer,) * 2, *(pointer,) * 2),
        "fit_edges": (
            integer,
            pointer,
            *(integer,) * 2,
            long,
            integer,
            ctypes.POINTER(EdgeParameters),
            *(pointer,) * 4,
        ),
        "decode_cells": (integer, pointer, long, integer, pointer, tables, integer, constants, pointer),
        "code_products": (integer, pointer, long, integer, pointer, long, long, pointer),
        "sample_squares": (
            integer,
            pointer,
            *(integer,) * 2,
            pointer,
            long,
            pointer,
            *(integer,) * 2,
            pointer,
        ),
    }
