"""Typed functions of the compiled library of vision, which check their arguments."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, Image, IntArray
from skyherd.native.arguments import address, check, check_plane
from skyherd.native.loading import Signature, declare, library_of
from skyherd.vision.native.follow_records import FollowRequest, FollowResults
from skyherd.vision.native.pattern_records import PATTERN_FIT, PatternRequest
from skyherd.vision.native.records import (
    ERRORS,
    FIT,
    MAX_SECOND_DIFFERENCE,
    PLANE,
    POSE_UNKNOWNS,
    BlurRequest,
    FitRequest,
    VisibleRequest,
)
from skyherd.vision.native.search_library import SearchFunctions, search_signatures


@dataclass(frozen=True)
class Library(SearchFunctions):
    """One loaded build of the library, with all of its functions."""

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

    def fit_any_blur(
        self, request: BlurRequest, plane: npt.NDArray[np.void]
    ) -> tuple[npt.NDArray[np.void], Array, Array]:
        """Fit markers of any size until they have found their blurs (`photometric.refine`).

        Args:
            request: the markers, N of them, at least one.
            plane: (1,) of `PLANE`, the one that is known; that of the first fit replaces it.

        Returns:
            The fits (N,) of `FIT`, the mean residuals (N, n, n) over the cells, grey levels, and the standard
            deviations (N,) of the blurs that were assumed, in marker sides.

        Raises:
            InputError: an argument has another type, shape or memory layout, or is out of range.
        """
        count, n_cells = len(request.start), request.cells.shape[1] - 2
        empty = np.empty(count, dtype=FIT), np.empty((count, n_cells, n_cells)), np.empty(count)
        fits, means, blurs = request.fitted or empty
        fits, means, blurs, sigmas_px = fits.copy(), means.copy(), blurs.copy(), request.sigmas_px.copy()
        given = (
            ctypes.byref(request.structure()),
            address("plane", plane, PLANE, (1,)),
            address("sigmas_px", sigmas_px, np.float64, (count,)),
            address("fits", fits, FIT, (count,)),
            address("cell_means", means, np.float64, (count, n_cells, n_cells)),
            address("blurs", blurs, np.float64, (count,)),
        )
        check(self.functions.fit_any_blur(*given), ERRORS)
        return fits, means, blurs

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

    def fit_freely(self, request: FitRequest, settled_px: float) -> tuple[npt.NDArray[np.void], Array]:
        """Fit markers with all eight numbers of each homography free (`photometric.remeasure`).

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
        covariances = np.empty((count, POSE_UNKNOWNS, POSE_UNKNOWNS))
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
    signatures: dict[str, Signature] = {
        **search_signatures(),
        "count_second_differences": (integer, pointer, long, long, integer, integer, pointer),
        "fit_markers": (integer, pointer, pointer, pointer, pointer),
        "fit_any_blur": (integer, *(pointer,) * 6),
        "fit_visible": (integer, pointer, pointer, pointer, pointer),
        "fit_freely": (integer, pointer, ctypes.c_double, *(pointer,) * 3),
        "streak_evidence": (integer, pointer, pointer, pointer),
        "fit_patterns": (integer, pointer, pointer),
        "best_rectangles": (integer, pointer, long, integer, pointer, integer, pointer, pointer),
        "follow_markers": (integer, pointer, pointer),
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
