"""Typed functions of the compiled library of the renderer, which check their arguments."""

import ctypes
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.geometry import Array, Image
from skyherd.native.arguments import address, check
from skyherd.native.loading import declare, library_of
from skyherd.render.edge import BOXY, DIRECTIONS, FELT, REACH, SAMPLES, SLANTED, SQUARE, EdgeSpread, Float

LENS_FIELDS = 6
"""Planes of a lens field: two displacements and four derivatives."""

ERRORS = {
    -1: ("canvas", "an invalid size", "1 to 2**20 pixels a side, 2**30 in all"),
    -2: ("shapes", "invalid shapes", "3 to 16 corners, 1 or 3 instants, a margin of 0 or more"),
    -3: ("spread", "an invalid edge spread", "a positive sigma"),
    -4: ("levels", "an invalid number of cells", "1 to 62 cells a side"),
    -5: ("texture", "an invalid texture", "n rows and more than n columns, n a power of two up to 2**14"),
}
"""Negative results of the library: the argument, the problem and the allowed values."""

Canvas = npt.NDArray[np.uint8] | Float
"""Image (height, width) to draw on: grey levels of 8 bits, or light as float32."""


@dataclass(frozen=True)
class Frame:
    """Lens and shutter of an image.

    Attributes:
        row_times: (height,) times of the rows, -1, 0 and 1 at the first, the middle and the last instant.
        lens: (6, height x width) `LensField.fields`; None without distortion.
    """

    row_times: Array
    lens: Float | None = None


@dataclass(frozen=True)
class FlatShapes:
    """Flat shapes in an image.

    Attributes:
        outlines_px: (N, V, 2) corners of convex polygons around the shapes, px.
        matrices: (Q, N, 3, 3) homographies from undistorted pixels to shape coordinates, at one instant or
            three.
        margin_px: distance beyond the outline at which a pixel may still be affected.
    """

    outlines_px: Array
    matrices: Array
    margin_px: float


class _Canvas(ctypes.Structure):
    """`Canvas` of `render.h`."""

    _fields_ = (
        ("width", ctypes.c_int32),
        ("height", ctypes.c_int32),
        ("image", ctypes.c_void_p),
        ("light", ctypes.c_void_p),
        ("lens", ctypes.c_void_p),
        ("row_times", ctypes.c_void_p),
    )


class _Shapes(ctypes.Structure):
    """`Shapes` of `render.h`."""

    _fields_ = (
        ("count", ctypes.c_int32),
        ("corners", ctypes.c_int32),
        ("instants", ctypes.c_int32),
        ("outlines_px", ctypes.c_void_p),
        ("matrices", ctypes.c_void_p),
        ("margin_px", ctypes.c_double),
    )


class _EdgeSpread(ctypes.Structure):
    """`EdgeSpread` of `render.h`."""

    _fields_ = (
        ("sigma_px", ctypes.c_double),
        ("kurtosis", ctypes.c_double),
        ("reach", ctypes.c_double),
        ("felt", ctypes.c_double),
        ("square", ctypes.c_double),
        ("boxy", ctypes.c_double),
        ("slanted", ctypes.c_double),
        ("table", ctypes.c_void_p),
        ("directions", ctypes.c_int32),
        ("samples", ctypes.c_int32),
    )


@dataclass(frozen=True)
class Library:
    """One loaded build of the library.

    Attributes:
        functions: the shared library, its functions with argument and result types.
    """

    functions: ctypes.CDLL

    def draw_lattices(
        self, canvas: Canvas, frame: Frame, shapes: FlatShapes, levels: Float, spread: EdgeSpread
    ) -> None:
        """Draw grids of grey cells over the canvas, in place and in their order.

        Args:
            canvas: the image to draw on.
            frame: lens and shutter of the image.
            shapes: N grids, in columns and rows of cells.
            levels: (N, m + 2, m + 2) float32, grey levels of the cells in a border of zeros.
            spread: edge spread function of lens and pixel.

        Raises:
            InputError: an argument has another type, shape or memory layout, or an invalid value.
        """
        cells = (np.shape(levels) or (0,))[-1] - 2
        count = _count(shapes)
        levels_at = address("levels", levels, np.float32, (count, cells + 2, cells + 2))
        arguments = _arguments(canvas, frame, shapes, spread)
        check(self.functions.draw_lattices(*map(ctypes.byref, arguments), levels_at, cells), ERRORS)

    def draw_discs(
        self, canvas: Canvas, frame: Frame, shapes: FlatShapes, levels: Float, spread: EdgeSpread
    ) -> None:
        """Draw discs of grey levels (N,), float32, over the canvas, in place and in their order.

        In shape coordinates the discs have radius 1. The other arguments are those of `draw_lattices`.

        Raises:
            InputError: an argument has another type, shape or memory layout, or an invalid value.
        """
        levels_at = address("levels", levels, np.float32, (_count(shapes),))
        arguments = _arguments(canvas, frame, shapes, spread)
        check(self.functions.draw_discs(*map(ctypes.byref, arguments), levels_at), ERRORS)

    def draw_ground(self, size_px: tuple[int, int], frame: Frame, matrices: Array, texture: Image) -> Image:
        """Return the image (height, width) of a periodic texture on the ground, in grey levels.

        Args:
            size_px: width and height of the image.
            frame: lens and shutter of the image.
            matrices: (Q, 3, 3) homographies from undistorted pixels to samples, at one instant or three.
            texture: (n, m, 2) samples and their lower neighbours; n is a power of two, m > n, and column n
                repeats the first one.

        Raises:
            InputError: an argument has another type, shape or memory layout, or an invalid value.
        """
        image = np.empty(size_px[::-1], dtype=np.uint8)
        samples, stride = np.shape(texture)[:2] if np.ndim(texture) == 3 else (0, 0)
        texture_at = address("texture", texture, np.uint8, (samples, stride, 2))
        instants = (np.shape(matrices) or (0,))[0]
        matrices_at = address("matrices", matrices, np.float64, (instants, 3, 3))
        canvas = ctypes.byref(_canvas(image, frame))
        check(self.functions.draw_ground(canvas, matrices_at, instants, texture_at, samples, stride), ERRORS)
        return image


def declared(functions: ctypes.CDLL) -> Library:
    """Return a loaded library with the types of its functions declared."""
    pointer, integer = ctypes.c_void_p, ctypes.c_int32
    drawing = (integer, *map(ctypes.POINTER, (_Canvas, _Shapes, _EdgeSpread)), pointer)
    ground = (integer, ctypes.POINTER(_Canvas), pointer, integer, pointer, integer, integer)
    signatures = {
        "draw_lattices": (*drawing, integer),
        "draw_discs": drawing,
        "draw_ground": ground,
    }
    declare(functions, signatures)
    return Library(functions)


@cache
def library() -> Library:
    """Return the library for this processor.

    Raises:
        NativeLibraryError: it is missing, cannot be loaded, or has been built from other sources.
    """
    return declared(library_of("render"))


def _arguments(
    canvas: Canvas, frame: Frame, shapes: FlatShapes, spread: EdgeSpread
) -> tuple[_Canvas, _Shapes, _EdgeSpread]:
    """Return the arguments that drawing functions begin with."""
    count, outlines_px = _count(shapes), shapes.outlines_px
    corners = outlines_px.shape[1]
    instants = (np.shape(shapes.matrices) or (0,))[0]
    return (
        _canvas(canvas, frame),
        _Shapes(
            count,
            corners,
            instants,
            address("outlines", outlines_px, np.float64, (count, corners, 2)),
            address("matrices", shapes.matrices, np.float64, (instants, count, 3, 3)),
            shapes.margin_px,
        ),
        _EdgeSpread(
            spread.sigma_px,
            spread.kurtosis,
            REACH,
            FELT,
            SQUARE,
            BOXY,
            SLANTED,
            address("table", spread.table, np.float32, (DIRECTIONS * SAMPLES,)),
            DIRECTIONS,
            SAMPLES,
        ),
    )


def _canvas(canvas: Canvas | Image, frame: Frame) -> _Canvas:
    """Return the canvas of an image, which is written."""
    allowed = "contiguous and writable, (height, width), uint8 or float32"
    if not isinstance(canvas, np.ndarray):
        raise InputError("canvas", f"a {type(canvas).__name__}", allowed)
    is_light = canvas.dtype == np.float32
    if canvas.ndim != 2 or not (is_light or canvas.dtype == np.uint8) or not canvas.flags.carray:
        raise InputError("canvas", f"shape {canvas.shape}, {canvas.dtype}", allowed)
    height, width = canvas.shape
    lens = frame.lens
    return _Canvas(
        width,
        height,
        None if is_light else canvas.ctypes.data,
        canvas.ctypes.data if is_light else None,
        None if lens is None else address("lens", lens, np.float32, (LENS_FIELDS, canvas.size)),
        address("row_times", frame.row_times, np.float64, (height,)),
    )


def _count(shapes: FlatShapes) -> int:
    """Return the number of shapes.

    Raises:
        InputError: the outlines are not an array of three axes.
    """
    outlines_px = shapes.outlines_px
    if np.ndim(outlines_px) != 3:
        raise InputError("outlines", f"{np.shape(outlines_px)}", "(shapes, corners, 2), float64")
    return len(outlines_px)
