"""Records and structures that the compiled library of vision shares with Python."""

import ctypes
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, Image
from skyherd.native.arguments import address, check_plane

UNKNOWNS, POSE_UNKNOWNS = 15, 8
"""Unknowns of a marker, and those of them that make up a step of its pose."""

MAX_SECOND_DIFFERENCE = 4 * 255
"""Largest second difference of grey levels. Derived."""

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
        ("enlargement", ctypes.c_int32),
    )


class EdgeParameters(ctypes.Structure):
    """Parameters of the refinement of corners by edges; `search.h` declares the same fields."""

    _fields_ = (
        ("end_share", ctypes.c_double),
        ("reach_cells", ctypes.c_double),
        ("min_reach_px", ctypes.c_double),
        ("max_reach_px", ctypes.c_double),
        ("tukey_sigmas", ctypes.c_double),
        ("min_spread_px", ctypes.c_double),
        ("median_per_sigma", ctypes.c_double),
        ("min_inlier_weight", ctypes.c_double),
        ("min_crossing", ctypes.c_double),
        ("min_divisor", ctypes.c_double),
        ("normals", ctypes.c_int32),
        ("steps", ctypes.c_int32),
        ("rounds", ctypes.c_int32),
        ("reweightings", ctypes.c_int32),
    )


HOMOGRAPHY = np.dtype(
    [("centers", complex), ("similarities", complex), ("anisotropies", complex), ("perspectives", complex)]
)
"""Record of a marker's homography, as `Homography` in `fit.h`; the names are those of `LocalHomographies`."""

SURROUNDINGS = np.dtype([("levels", float), ("textures", float)])
"""Record of the ground around a marker, as `Surroundings` in `fit.h`; the names are those of
`fitting.surroundings`."""

APPEARANCE = np.dtype(
    [
        ("sigma", float),
        ("limit", float),
        ("half_card", float),
        ("black_ratio", float),
        ("surroundings", SURROUNDINGS),
    ],
)
"""Record of a marker's appearance, as `Appearance` in `fit.h`; lengths are in marker sides."""

PLANE = np.dtype(
    [("anisotropy", complex), ("perspective", complex), ("covariance", complex, (2, 2)), ("shared", np.int64)]
)
"""Record of a plane, as `Plane` in `fit.h`; the names are those of `fitting.plane.Plane`."""

FIT = np.dtype(
    [
        ("homography", HOMOGRAPHY),
        ("covariances", float, (3, 3)),
        ("blacks", float),
        ("contrasts", float),
        ("noise_stds", float),
        ("peaks", float),
        ("log_blurs", float),
        ("sigmas_px", float),
        ("pixels", float),
        ("moved_px", float),
        ("variance_ratios", float, (2,)),
        ("boxes", float),
        ("surroundings", SURROUNDINGS),
        ("besides", float),
    ]
)
"""Record of a fit, as `Fit` in `fit.h`; the names are those of `fitting.fit_result.FitResults`."""


class PlaneLimits(ctypes.Structure):
    """Limits of a plane, as `PlaneLimits` in `fit.h`; `fitting.plane` has their reasons."""

    _fields_ = (
        ("significant", ctypes.c_double),
        ("excess", ctypes.c_double),
        ("converged", ctypes.c_double),
        ("ridge", ctypes.c_double),
        ("min_share", ctypes.c_double),
        ("min_markers", ctypes.c_int32),
        ("max_rounds", ctypes.c_int32),
    )


class FitConstants(ctypes.Structure):
    """Constants of the fit; `fit.h` has the same fields, and says which module defines each."""

    _fields_ = (
        *(
            (name, ctypes.c_double)
            for name in (
                *("ground_ridge", "ridge", "single_precision", "min_squares", "min_contrast"),
                *("max_growth", "min_sigma", "max_sigma"),
                *("steep_anisotropy", "min_variance_px2"),
                *("min_print_share", "free_sigmas", "max_tone", "keystone_std", "near_plane"),
                *("max_step", "min_step", "settled_px", "settled_perspective_px", "off_cell"),
                *("max_log_blur", "kept_share"),
            )
        ),
        ("plane", PlaneLimits),
        ("min_markers_for_tone", ctypes.c_int32),
        ("min_pixels_for_plane", ctypes.c_int32),
        ("box_px", ctypes.c_int32),
        ("max_box_markers", ctypes.c_int32),
    )


class FitRequestStructure(ctypes.Structure):
    """Markers to be fitted; `FitRequest` in `fit.h` has the same fields."""

    _fields_ = (
        ("image", ctypes.c_void_p),
        ("start", ctypes.c_void_p),
        ("appearances", ctypes.c_void_p),
        ("cells", ctypes.c_void_p),
        ("constants", ctypes.POINTER(FitConstants)),
        ("height", ctypes.c_int64),
        ("width", ctypes.c_int64),
        ("count", ctypes.c_int64),
        ("streak_real_px2", ctypes.c_double),
        ("streak_imaginary_px2", ctypes.c_double),
        ("texture", ctypes.c_double),
        ("noise", ctypes.c_double),
        ("n", ctypes.c_int32),
        ("max_steps", ctypes.c_int32),
        ("alone", ctypes.c_int32),
        ("has_streak", ctypes.c_int32),
    )


@dataclass(frozen=True)
class FitRequest:
    """N markers to be fitted, at least one, and where the fit begins.

    Attributes:
        image: grey, (height, width).
        start: (N,) of `HOMOGRAPHY`.
        appearances: (N,) of `APPEARANCE`.
        cells: (N, n + 2, n + 2) 1 where a cell is black, 0 where it is white and on the ground around.
        constants: of the fit.
        texture: standard deviation of the ground's texture over that of the noise.
        noise: standard deviation of a pixel, grey levels.
        max_steps: most steps.
        alone: whether each marker has a plane of its own in any case.
        streak_px2: Q of the blur, px²; None for round blur.
    """

    image: Image
    start: npt.NDArray[np.void]
    appearances: npt.NDArray[np.void]
    cells: Floats
    constants: FitConstants
    texture: float
    noise: float
    max_steps: int
    alone: bool
    streak_px2: complex | None

    def structure(self) -> FitRequestStructure:
        """Return the structure of the request, which is valid as long as its arrays.

        Raises:
            InputError: an array has another type, shape or memory layout.
        """
        count, sides, streak = len(self.start), self.cells.shape[1], self.streak_px2 or 0j
        check_plane("image", self.image, None)
        return FitRequestStructure(
            self.image.ctypes.data,
            address("start", self.start, HOMOGRAPHY, (count,)),
            address("appearances", self.appearances, APPEARANCE, (count,)),
            address("cells", self.cells, np.float32, (count, sides, sides)),
            ctypes.pointer(self.constants),
            *self.image.shape,
            count,
            streak.real,
            streak.imag,
            self.texture,
            self.noise,
            sides - 2,
            self.max_steps,
            self.alone,
            self.streak_px2 is not None,
        )


class AppearanceConstants(ctypes.Structure):
    """Constants of appearances, as in `fit.h`; see `fitting.appearance`."""

    _fields_ = tuple(
        (name, ctypes.c_double)
        for name in ("quiet", "outside_sigmas", "inside_sigmas", "ground_sigmas", "texture", "black_ratio")
    )


class BlurConstants(ctypes.Structure):
    """Limits of blurs, and of fits about them, as in `fit.h`; see `photometric.refine`."""

    _fields_ = (
        *(
            (name, ctypes.c_double)
            for name in ("min_sigma_px", "max_sigma_cells", "settled", "min_contrast", "max_wrong_share")
        ),
        ("steps_per_round", ctypes.c_int32),
    )


class BlurRequestStructure(ctypes.Structure):
    """Markers of any size under blurs that are not known; `BlurRequest` in `fit.h` has the same fields."""

    _fields_ = (
        ("markers", ctypes.POINTER(FitRequestStructure)),
        ("around", ctypes.c_void_p),
        ("looks", ctypes.POINTER(AppearanceConstants)),
        ("limits", ctypes.POINTER(BlurConstants)),
        ("max_side_px", ctypes.c_double),
        ("rounds", ctypes.c_int32),
        ("is_fitted", ctypes.c_int32),
    )


@dataclass(frozen=True)
class BlurRequest:
    """N markers of any size, at least one, under blurs that are not known.

    Attributes:
        image: grey, (height, width).
        start: (N,) of `HOMOGRAPHY`.
        sigmas_px: (N,) standard deviations of the blurs that the first fit assumes, px.
        surroundings: (N,) of `SURROUNDINGS`.
        cells: (N, n + 2, n + 2) 1 where a cell is black, 0 where it is white and on the ground around.
        constants: of the fit.
        looks: constants of the appearances.
        limits: of the blurs, and of the fits.
        noise: standard deviation of a pixel, grey levels.
        max_steps: most steps of the first fit.
        alone: whether each marker has a plane of its own in any case.
        streak_px2: Q of the blur, px²; None for round blur.
        max_side_px: side above which a marker is fitted in a shrunk image.
        rounds: most fits after the first one.
        fitted: (N,) of `FIT`, (N, n, n) mean residuals and (N,) blurs in sides of the first fit, if known.
    """

    image: Image
    start: npt.NDArray[np.void]
    sigmas_px: Array
    surroundings: npt.NDArray[np.void]
    cells: Floats
    constants: FitConstants
    looks: AppearanceConstants
    limits: BlurConstants
    noise: float
    max_steps: int
    alone: bool
    streak_px2: complex | None
    max_side_px: float
    rounds: int
    fitted: tuple[npt.NDArray[np.void], Array, Array] | None

    def structure(self) -> BlurRequestStructure:
        """Return the structure of the request, which is valid as long as its arrays.

        Raises:
            InputError: an array has another type, shape or memory layout.
        """
        count, sides, streak = len(self.start), self.cells.shape[1], self.streak_px2 or 0j
        check_plane("image", self.image, None)
        markers = FitRequestStructure(
            self.image.ctypes.data,
            address("start", self.start, HOMOGRAPHY, (count,)),
            None,
            address("cells", self.cells, np.float32, (count, sides, sides)),
            ctypes.pointer(self.constants),
            *self.image.shape,
            count,
            streak.real,
            streak.imag,
            0.0,
            self.noise,
            sides - 2,
            self.max_steps,
            self.alone,
            self.streak_px2 is not None,
        )
        return BlurRequestStructure(
            ctypes.pointer(markers),
            address("surroundings", self.surroundings, SURROUNDINGS, (count,)),
            ctypes.pointer(self.looks),
            ctypes.pointer(self.limits),
            self.max_side_px,
            self.rounds,
            self.fitted is not None,
        )


class VisibleConstants(ctypes.Structure):
    """Constants of the fit to visible pixels, as `VisibleConstants` in `fit.h`; see `fitting.occlusion`."""

    _fields_ = (
        ("inlier_sigmas", ctypes.c_double),
        ("pixel_share", ctypes.c_double),
        ("limit_factor", ctypes.c_double),
        ("margin_sigmas", ctypes.c_double),
        ("cover_share", ctypes.c_double),
        ("min_visible_share", ctypes.c_double),
        ("min_clear_share", ctypes.c_double),
        ("final_rounds", ctypes.c_int32),
        ("min_cover_px", ctypes.c_int32),
    )


class VisibleRequestStructure(ctypes.Structure):
    """Markers of which a part may be covered; `VisibleRequest` in `fit.h` has the same fields."""

    _fields_ = (
        ("markers", ctypes.POINTER(FitRequestStructure)),
        ("constants", ctypes.POINTER(VisibleConstants)),
        ("blacks", ctypes.c_void_p),
        ("contrasts", ctypes.c_void_p),
        ("sigmas_px", ctypes.c_void_p),
        ("border", ctypes.c_int64),
        ("settled", ctypes.c_int32),
    )


@dataclass(frozen=True)
class VisibleRequest:
    """N markers, at least one, of which a part may be covered.

    Attributes:
        markers: where the fit begins, with the black ratios of a fit to all pixels.
        constants: of the fit to visible pixels.
        blacks: (N,) black levels of the fit to all pixels, grey levels.
        contrasts: (N,) its contrasts, grey levels.
        sigmas_px: (N,) standard deviations of the blur of lens and pixel together, px.
        border: width of the markers' border, cells.
        settled: whether the fit begins where it ended, and finds the plane.
    """

    markers: FitRequest
    constants: VisibleConstants
    blacks: Array
    contrasts: Array
    sigmas_px: Array
    border: int
    settled: bool = False

    def structure(self) -> VisibleRequestStructure:
        """Return the structure of the request, which is valid as long as its arrays.

        Raises:
            InputError: an array has another type, shape or memory layout.
        """
        count = len(self.markers.start)
        return VisibleRequestStructure(
            ctypes.pointer(self.markers.structure()),
            ctypes.pointer(self.constants),
            address("blacks", self.blacks, np.float64, (count,)),
            address("contrasts", self.contrasts, np.float64, (count,)),
            address("sigmas_px", self.sigmas_px, np.float64, (count,)),
            self.border,
            self.settled,
        )
