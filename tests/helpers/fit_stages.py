"""Typed functions of the compiled stages of a fit, which a fit calls in one go: for references and tests."""

import ctypes
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray, ComplexArray, Image, IntArray
from skyherd.native.arguments import address, check
from skyherd.native.loading import declare, library_of
from skyherd.vision.native.records import ERRORS, PLANE, UNKNOWNS, Floats, PlaneLimits

COLUMNS, BLOCK_PX = 16, 16
"""Columns of a pixel: those of the model, and its own value. Pixels of a block, as in `fit.h`."""

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
        ("ground_level", float),
        ("is_bare", np.int64),
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
- `half_card`, the distance of the card's edge from the centre, infinite where no ground is seen;
- `ground_level`, of the ground less white over the contrast, and `is_bare`, whether the marker has no card.
"""


class Blocks(ctypes.Structure):
    """Pixels of markers; `MarkerBlocks` in `fit.h` has the same fields."""

    _fields_ = (
        ("bounds", ctypes.c_void_p),
        ("counts", ctypes.c_void_p),
        ("places", ctypes.c_void_p),
        ("pixels", ctypes.c_void_p),
        ("columns", ctypes.c_void_p),
        ("count", ctypes.c_int64),
        ("blocks", ctypes.c_int64),
    )


class Scene(ctypes.Structure):
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
class MarkerBlocks:
    """The pixels of N markers, and the model's columns at them, in B blocks of `BLOCK_PX` pixels.

    A marker's last block repeats its last pixel, with columns of 0.

    Attributes:
        bounds: (N + 1,) marker k has the blocks from `bounds[k]` to `bounds[k + 1]`.
        counts: (N,) pixels of each marker.
        places: (B, 2, BLOCK_PX) marker coordinates x and y, in sides.
        pixels: (B, 2, BLOCK_PX) lines v and columns u in the image.
        columns: (B, 16, BLOCK_PX) the model's columns and the pixels less 128, times the pixels' weights.
    """

    bounds: IntArray
    counts: IntArray
    places: Floats
    pixels: npt.NDArray[np.int32]
    columns: Floats

    def is_pixel(self) -> BoolArray:
        """Return which places (B, BLOCK_PX) of the blocks have a pixel of their own."""
        blocks = np.diff(self.bounds)
        before = BLOCK_PX * (np.arange(len(self.columns)) - np.repeat(self.bounds[:-1], blocks))
        return before[:, None] + np.arange(BLOCK_PX) < np.repeat(self.counts, blocks)[:, None]

    def by_pixels(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return values (B, K, BLOCK_PX) of blocks as values (P, K) of all pixels, one after the other."""
        return np.ascontiguousarray(np.moveaxis(values, 1, 2)[self.is_pixel()])

    def structure(self, first: int = 0, end: int | None = None) -> Blocks:
        """Return the structure of the markers from `first` to `end`, which is valid as long as the arrays.

        Raises:
            InputError: an array has another type, shape or memory layout.
        """
        blocks = len(self.columns)
        return Blocks(
            address("bounds", self.bounds, np.int64, (self.bounds.size,)) + 8 * first,
            address("counts", self.counts, np.int64, (self.bounds.size - 1,)) + 8 * first,
            address("places", self.places, np.float32, (blocks, 2, BLOCK_PX)),
            address("pixels", self.pixels, np.int32, (blocks, 2, BLOCK_PX)),
            address("columns", self.columns, np.float32, (blocks, COLUMNS, BLOCK_PX)),
            (self.bounds.size - 1 if end is None else end) - first,
            blocks,
        )


def scene_structure(
    image: Image, markers: npt.NDArray[np.void], cells: Floats, texture: float, first: int
) -> Scene:
    """Return the structure of an image and of the markers from `first` on, which the arrays keep valid."""
    sides = cells.shape[1]
    return Scene(
        address("image", image, np.uint8, image.shape),
        address("markers", markers, MARKER, (markers.size,)) + MARKER.itemsize * first,
        address("cells", cells, np.float32, (markers.size, sides, sides)) + 4 * sides**2 * first,
        *image.shape,
        sides - 2,
        texture * texture,
    )


@dataclass(frozen=True)
class FitStages:
    """The stages of a fit in one loaded build of the library.

    Attributes:
        functions: the shared library, its functions with argument and result types.
    """

    functions: ctypes.CDLL

    def list_pixels(self, markers: npt.NDArray[np.void], shape: tuple[int, int]) -> MarkerBlocks:
        """Return the pixels of N markers (`MARKER`) in an image of a shape, with columns not filled in.

        Raises:
            InputError: `markers` has another type, shape or memory layout.
        """
        given = address("markers", markers, MARKER, (markers.size,)), markers.size, *shape
        room = self.functions.count_blocks(*given)
        bounds, counts = np.empty(markers.size + 1, dtype=np.int64), np.empty(markers.size, dtype=np.int64)
        places, pixels = (
            np.empty((room, 2, BLOCK_PX), dtype=np.float32),
            np.empty((room, 2, BLOCK_PX), np.int32),
        )
        results = (array.ctypes.data for array in (bounds, counts, places, pixels))
        blocks = check(self.functions.list_pixels(*given, *results, room), ERRORS)
        columns = np.empty((blocks, COLUMNS, BLOCK_PX), dtype=np.float32)
        return MarkerBlocks(bounds, counts, places[:blocks], pixels[:blocks], columns)

    def fill_round(
        self,
        image: Image,
        markers: npt.NDArray[np.void],
        cells: Floats,
        texture: float,
        blocks: MarkerBlocks,
        first: int = 0,
        end: int | None = None,
    ) -> None:
        """Fill in the columns of the markers from `first` to `end`, under blur that is round in the marker.

        Args:
            image: grey, (height, width).
            markers: (N,) of `MARKER`.
            cells: (N, n + 2, n + 2) 1 where a cell is black, 0 where it is white and on the ground around.
            texture: standard deviation of the ground's texture over that of the noise.
            blocks: of the N markers, whose columns are written.
            first: index of the first marker.
            end: index behind the last one; N if left out.

        Raises:
            InputError: an argument has another type, shape or memory layout, or a size beyond its limit.
        """
        scene = scene_structure(image, markers, cells, texture, first)
        check(self.functions.fill_round(scene, blocks.structure(first, end)), ERRORS)

    def fill_elliptic(
        self,
        image: Image,
        markers: npt.NDArray[np.void],
        blurs: Array,
        cells: Floats,
        texture: float,
        blocks: MarkerBlocks,
        bends: Floats,
        first: int = 0,
        end: int | None = None,
    ) -> None:
        """Fill in the columns of markers under blur that is any ellipse; otherwise as `fill_round`.

        Args:
            image: as there.
            markers: as there; `sigma`, `anisotropy` and the stretches are not used.
            blurs: (N, 6) of `design_matrix_reference.blur_tables`: variances along x and y and covariance
                of the blur, in sides squared, and their changes with the logarithm of the blur.
            cells: as there.
            texture: as there.
            blocks: as there.
            bends: (B, 3, BLOCK_PX) result: T_xx, T_xy and T_yy, times the pixels' weights.
            first: as there.
            end: as there.

        Raises:
            InputError: as there.
        """
        scene = scene_structure(image, markers, cells, texture, first)
        tables = address("blurs", blurs, np.float64, (markers.size, 6)) + 48 * first
        written = address("bends", bends, np.float32, (len(blocks.columns), 3, BLOCK_PX))
        check(self.functions.fill_elliptic(scene, blocks.structure(first, end), tables, written), ERRORS)

    def gram_matrices(self, blocks: MarkerBlocks) -> Floats:
        """Return the inner products (N, 16, 16) of the weighted columns.

        Raises:
            InputError: an array of `blocks` has another type, shape or memory layout.
        """
        grams = np.empty((blocks.bounds.size - 1, COLUMNS, COLUMNS), dtype=np.float32)
        check(self.functions.gram_matrices(blocks.structure(), grams.ctypes.data), ERRORS)
        return grams

    def residuals(self, blocks: MarkerBlocks, solutions: Floats) -> Floats:
        """Return the weighted residuals (P,), grey levels, of the model at `solutions` (N, 15).

        Raises:
            InputError: an array has another type, shape or memory layout.
        """
        left = np.zeros((len(blocks.columns), BLOCK_PX), dtype=np.float32)
        model = address("solutions", solutions, np.float32, (blocks.bounds.size - 1, UNKNOWNS))
        check(self.functions.residuals(blocks.structure(), model, left.ctypes.data), ERRORS)
        return left[blocks.is_pixel()]

    def cell_sums(
        self, blocks: MarkerBlocks, solutions: Floats, n_cells: int
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Return residuals of the model at `solutions` (N, 15), summed over cells.

        Returns:
            The sums (N, n, n) of residuals, grey levels; the numbers of pixels with a weight, and of all
            pixels (both N, n, n); the largest absolute residuals of a pixel (N,); the mean residuals of the
            pixels beside the markers (N,).

        Raises:
            InputError: an array has another type, shape or memory layout, or there are more than 20 cells.
        """
        count = blocks.bounds.size - 1
        sums, used, read = np.zeros((3, count, n_cells, n_cells))
        peaks, besides = np.zeros((2, count))
        model = address("solutions", solutions, np.float32, (count, UNKNOWNS))
        results = (array.ctypes.data for array in (sums, used, read, peaks, besides))
        check(self.functions.add_over_cells(blocks.structure(), model, n_cells, *results), ERRORS)
        return sums, used, read, peaks, besides

    def squared_box_sums(
        self, blocks: MarkerBlocks, solutions: Floats, influences: Floats, picked: IntArray, box_px: int
    ) -> tuple[Array, Array, IntArray]:
        """Return influences times residuals, summed over boxes of pixels and squared, of some markers.

        Args:
            blocks: pixels of N markers.
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
        count, quantities = blocks.bounds.size - 1, influences.shape[1]
        small, large = np.zeros((2, picked.size, quantities))
        boxes = np.zeros(picked.size, dtype=np.int64)
        given = (
            address("picked", picked, np.int64, (picked.size,)),
            picked.size,
            address("solutions", solutions, np.float32, (count, UNKNOWNS)),
            address("influences", influences, np.float32, (count, quantities, UNKNOWNS)),
        )
        results = (array.ctypes.data for array in (small, large, boxes))
        check(self.functions.add_over_boxes(blocks.structure(), *given, quantities, box_px, *results), ERRORS)
        return small, large, boxes

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
            address("values", values, np.float64, (count, UNKNOWNS)),
            address("inverse_normals", inverse_normals, np.float64, (count, UNKNOWNS, UNKNOWNS)),
            address("squares", squares, np.float64, (count,)),
        )
        targets = (
            address("at", at, np.float64, (count, len(set(unknowns)))),
            address("variances", variances, np.float64, (count,)),
        )
        check(self.functions.hold_unknowns(*solutions, count, *unknowns, *targets), ERRORS)

    def fit_plane(
        self,
        points: ComplexArray,
        anisotropies: ComplexArray,
        variances: Array,
        limits: PlaneLimits,
        *,
        most: bool,
    ) -> npt.NDArray[np.void]:
        """Return the simplest plane, (1,) of `PLANE`, of anisotropies (N,) at image points (N,).

        Args:
            points: (N,) px from the image's centre.
            anisotropies: (N,) in image axes.
            variances: (N,) of each of the anisotropies' components.
            limits: of `fitting.plane`.
            most: whether a plane that explains most of the anisotropies is enough.

        Raises:
            InputError: an argument has another type, shape or memory layout.
        """
        count, plane = points.size, np.zeros(1, dtype=PLANE)
        given = (
            address("points", points, np.complex128, (count,)),
            address("anisotropies", anisotropies, np.complex128, (count,)),
            address("variances", variances, np.float64, (count,)),
        )
        result = self.functions.fit_plane(ctypes.byref(limits), *given, count, most, plane.ctypes.data)
        check(result, ERRORS)
        return plane


def declared_stages(functions: ctypes.CDLL) -> FitStages:
    """Return the stages of a loaded library with the types of its functions declared."""
    pointer, integer, long = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64
    scene, blocks = ctypes.POINTER(Scene), ctypes.POINTER(Blocks)
    signatures = {
        "count_blocks": (long, pointer, long, long, long),
        "list_pixels": (long, pointer, long, long, long, *(pointer,) * 4, long),
        "fill_round": (integer, scene, blocks),
        "fill_elliptic": (integer, scene, blocks, pointer, pointer),
        "gram_matrices": (integer, blocks, pointer),
        "residuals": (integer, blocks, pointer, pointer),
        "add_over_cells": (integer, blocks, pointer, integer, *(pointer,) * 5),
        "add_over_boxes": (integer, blocks, pointer, long, *(pointer,) * 2, *(integer,) * 2, *(pointer,) * 3),
        "hold_unknowns": (integer, *(pointer,) * 3, long, integer, integer, pointer, pointer),
        "fit_plane": (integer, *(pointer,) * 4, long, integer, pointer),
    }
    declare(functions, signatures)
    return FitStages(functions)


@cache
def stages() -> FitStages:
    """Return the stages of the library for this processor."""
    return declared_stages(library_of("vision"))
