"""Typed functions of the compiled library of vision, which check their arguments."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, ComplexArray, Image, IntArray
from skyherd.native.arguments import address, check, check_plane
from skyherd.native.loading import Signature, declare, library_of
from skyherd.vision.native.follow_records import FollowRequest, FollowResults
from skyherd.vision.native.pattern_records import PATTERN_FIT, PatternRequest
from skyherd.vision.native.records import (
    BLOCK_PX,
    COLUMNS,
    ERRORS,
    FIT,
    MARKER,
    MAX_SECOND_DIFFERENCE,
    PLANE,
    UNKNOWNS,
    Blocks,
    FitRequest,
    Floats,
    MarkerBlocks,
    PlaneLimits,
    Scene,
    VisibleRequest,
    scene_structure,
)
from skyherd.vision.native.search_library import SearchFunctions, search_signatures


@dataclass(frozen=True)
class Library(SearchFunctions):
    """One loaded build of the library, with all of its functions."""

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
            blurs: (N, 6) of `blur_ellipses.blur_tables`: variances along x and y and covariance of the blur,
                in sides squared, and their changes with the logarithm of the blur.
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
    ) -> tuple[Array, Array, Array, Array]:
        """Return residuals of the model at `solutions` (N, 15), summed over cells.

        Returns:
            The sums (N, n, n) of residuals, grey levels; the numbers of pixels with a weight, and of all
            pixels (both N, n, n); the largest absolute residuals of a pixel (N,).

        Raises:
            InputError: an array has another type, shape or memory layout, or there are more than 20 cells.
        """
        count = blocks.bounds.size - 1
        sums, used, read = np.zeros((3, count, n_cells, n_cells))
        peaks = np.zeros(count)
        model = address("solutions", solutions, np.float32, (count, UNKNOWNS))
        results = (array.ctypes.data for array in (sums, used, read, peaks))
        check(self.functions.add_over_cells(blocks.structure(), model, n_cells, *results), ERRORS)
        return sums, used, read, peaks

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

    def second_differences(self, image: Image, darkest: int, brightest: int) -> IntArray:
        """Return how often each `|I(u - 1) - 2 I(u) + I(u + 1)|` (1021,) occurs along lines of an image.

        Every fourth column is read of every fourth line, of a large image of fewer lines, where I(u) is above
        `darkest` and below `brightest`.

        Raises:
            InputError: the image has another type, shape or memory layout.
        """
        check_plane("image", image, None)
        counts = np.empty(MAX_SECOND_DIFFERENCE + 1, dtype=np.int64)
        given = image.ctypes.data, *image.shape, darkest, brightest
        check(self.functions.count_second_differences(*given, counts.ctypes.data), ERRORS)
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
            address("values", values, np.float64, (count, UNKNOWNS)),
            address("inverse_normals", inverse_normals, np.float64, (count, UNKNOWNS, UNKNOWNS)),
            address("squares", squares, np.float64, (count,)),
        )
        targets = (
            address("at", at, np.float64, (count, len(set(unknowns)))),
            address("variances", variances, np.float64, (count,)),
        )
        check(self.functions.hold_unknowns(*solutions, count, *unknowns, *targets), ERRORS)

    def fit_markers(
        self, request: FitRequest, plane: npt.NDArray[np.void]
    ) -> tuple[npt.NDArray[np.void], Array]:
        """Fit markers to the pixels of an image (`fitting.fit`).

        Args:
            request: the markers, N of them, at least one.
            plane: (1,) of `PLANE`, the one that is known; the one found replaces it.

        Returns:
            The fits (N,) of `FIT`, and the mean residuals (N, n, n) over the cells, grey levels.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is out of range.
        """
        return self._fit(self.functions.fit_markers, request.structure(), request, plane)

    def fit_visible(
        self, request: VisibleRequest, plane: npt.NDArray[np.void]
    ) -> tuple[npt.NDArray[np.void], Array]:
        """Fit markers to their visible pixels (`fitting.occlusion`).

        Args:
            request: the markers, N of them, at least one.
            plane: (1,) of `PLANE`, the one that is known; the one found replaces it.

        Returns:
            The fits (N,) of `FIT`, and the mean residuals (N, n, n) over the cells, grey levels; a hidden
            cell with a bit leaves the whole contrast.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is out of range.
        """
        return self._fit(self.functions.fit_visible, request.structure(), request.markers, plane)

    def fit_freely(
        self, request: FitRequest, settled_px: float
    ) -> tuple[npt.NDArray[np.void], Array]:
        """Fit markers with all eight numbers of each homography free (`photometric.outlines`).

        Args:
            request: the markers, N of them, at least one.
            settled_px: shift of the corners below which a step is the last one, px.

        Returns:
            The fits (N,) of `FIT`, and covariances (N, 8, 8) of the unknowns `POSE` in marker units, if noise
            is independent from pixel to pixel.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is out of range.
        """
        given, count, n_cells = request.structure(), len(request.start), request.cells.shape[1] - 2
        fits, means = np.empty(count, dtype=FIT), np.empty((count, n_cells, n_cells))
        covariances = np.empty((count, 8, 8))
        results = fits.ctypes.data, means.ctypes.data, covariances.ctypes.data
        check(self.functions.fit_freely(ctypes.byref(given), settled_px, *results), ERRORS)
        return fits, covariances

    def streak_evidence(self, request: FitRequest) -> tuple[Array, Array]:
        """Return the informations (N, 2, 2) and scores (N, 2) of `fitting.streak_evidence` for N markers.

        Args:
            request: the markers where they have settled, under the streak that they were fitted with.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is out of range.
        """
        informations, scores = np.empty((len(request.start), 2, 2)), np.empty((len(request.start), 2))
        given, results = request.structure(), (informations.ctypes.data, scores.ctypes.data)
        check(self.functions.streak_evidence(ctypes.byref(given), *results), ERRORS)
        return informations, scores

    def fit_patterns(self, request: PatternRequest) -> npt.NDArray[np.void]:
        """Return fits (N, K) of `PATTERN_FIT` of patterns to readings (`photometric.evidence.pattern_fit`).

        Raises:
            InputError: an argument has another type, shape or memory layout, or is out of range.
        """
        given, fits = request.structure(), np.empty(request.patterns.shape[:2], dtype=PATTERN_FIT)
        check(self.functions.fit_patterns(ctypes.byref(given), fits.ctypes.data), ERRORS)
        return fits

    def best_rectangles(self, sums: Array, unexplained: Array, each: int) -> IntArray:
        """Return the rectangles (N, each) that explain most of N squares, in no order.

        A rectangle's number is that of its stretch down times S plus that of its stretch along.

        Args:
            sums: (N, E, E) over what lies beyond pairs of E edges, down and along.
            unexplained: (S, S) squares of the rectangles, whose S stretches have two steps or more.
            each: rectangles that are kept.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is out of range.
        """
        count, edges = sums.shape[:2]
        stretches = (edges - 1) * (edges - 2) // 2
        given = (
            address("sums", sums, np.float64, (count, edges, edges)),
            count,
            edges,
            address("unexplained", unexplained, np.float64, (stretches, stretches)),
            each,
        )
        found, gains = np.empty((count, each), dtype=np.int32), np.empty((count, each))
        check(self.functions.best_rectangles(*given, found.ctypes.data, gains.ctypes.data), ERRORS)
        return found.astype(np.int64)

    def follow_markers(self, request: FollowRequest) -> tuple[int, FollowResults]:
        """Follow markers into an image; return how far it went, as `follow.h` says, and the results.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is out of range.
        """
        given, (results, memory) = request.structure(), FollowResults.room_for(request)
        end = self.functions.follow_markers(ctypes.byref(given), ctypes.byref(memory))
        return check(end, ERRORS), results.cut(memory)

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

    def _fit(
        self,
        function: Callable[..., int],
        given: ctypes.Structure,
        markers: FitRequest,
        plane: npt.NDArray[np.void],
    ) -> tuple[npt.NDArray[np.void], Array]:
        """Call one of both fits of N markers; return the fits (N,) and the cells' residuals (N, n, n)."""
        count, n_cells = len(markers.start), markers.cells.shape[1] - 2
        fits, means = np.empty(count, dtype=FIT), np.empty((count, n_cells, n_cells))
        known, results = address("plane", plane, PLANE, (1,)), (fits.ctypes.data, means.ctypes.data)
        check(function(ctypes.byref(given), known, *results), ERRORS)
        return fits, means


def declared(functions: ctypes.CDLL) -> Library:
    """Return a loaded library with the types of its functions declared."""
    pointer, integer, long = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64
    scene, blocks = ctypes.POINTER(Scene), ctypes.POINTER(Blocks)
    signatures: dict[str, Signature] = {
        **search_signatures(),
        "count_blocks": (long, pointer, long, long, long),
        "list_pixels": (long, pointer, long, long, long, *(pointer,) * 4, long),
        "fill_round": (integer, scene, blocks),
        "fill_elliptic": (integer, scene, blocks, pointer, pointer),
        "gram_matrices": (integer, blocks, pointer),
        "residuals": (integer, blocks, pointer, pointer),
        "add_over_cells": (integer, blocks, pointer, integer, *(pointer,) * 4),
        "add_over_boxes": (
            integer,
            blocks,
            pointer,
            long,
            pointer,
            pointer,
            integer,
            integer,
            *(pointer,) * 3,
        ),
        "count_second_differences": (integer, pointer, long, long, integer, integer, pointer),
        "hold_unknowns": (integer, *(pointer,) * 3, long, integer, integer, pointer, pointer),
        "fit_markers": (integer, pointer, pointer, pointer, pointer),
        "fit_visible": (integer, pointer, pointer, pointer, pointer),
        "fit_freely": (integer, pointer, ctypes.c_double, *(pointer,) * 3),
        "streak_evidence": (integer, pointer, pointer, pointer),
        "fit_patterns": (integer, pointer, pointer),
        "best_rectangles": (integer, pointer, long, integer, pointer, integer, pointer, pointer),
        "follow_markers": (integer, pointer, pointer),
        "fit_plane": (integer, *(pointer,) * 4, long, integer, pointer),
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
