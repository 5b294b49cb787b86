"""Records and structures that the compiled library of vision shares with Python."""

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray, Image, IntArray
from skyherd.native.arguments import address, check_plane

UNKNOWNS, COLUMNS = 15, 16
"""Unknowns of a marker, and columns of its pixels: those of the model, and the pixels' own values."""

BLOCK_PX = 16
"""Pixels of a block, as in `fit.h`."""

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


HOMOGRAPHY = np.dtype(
    [("centers", complex), ("similarities", complex), ("anisotropies", complex), ("perspectives", complex)]
)
"""Record of a marker's homography, as `Homography` in `fit.h`; the names are those of `LocalHomographies`."""

APPEARANCE = np.dtype(
    [("sigma", float), ("limit", float), ("half_card", float), ("black_ratio", float)],
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
