"""Records and structures of the following of markers that the compiled library shares with Python."""

import ctypes
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, Image, IntArray
from skyherd.native.arguments import address, check_plane
from skyherd.vision.native.records import (
    FIT,
    HOMOGRAPHY,
    PLANE,
    SURROUNDINGS,
    AppearanceConstants,
    BlurConstants,
    FitConstants,
    Floats,
)

TRACK = np.dtype(
    [
        ("ids", np.int64),
        ("times_s", float),
        ("homographies", HOMOGRAPHY),
        ("velocities", complex),
        ("similarity_log_rates", complex),
        ("on_arc", np.int64),
        ("sigmas_px", float),
        ("surroundings", SURROUNDINGS),
        ("missed", np.int64),
    ]
)
"""Record of a track, as `Track` in `follow.h`; the names are those of `photometric.tracks.Tracks`."""

DETECTION = np.dtype(
    [
        ("centers_px", float, (2,)),
        ("headings_rad", float),
        ("sides_px", float),
        ("corners_px", float, (4, 2)),
        ("covariances", float, (3, 3)),
    ]
)
"""Record of a detection, as `Detection` in `follow.h`; the names are those of `Detections`."""


def _doubles(names: str) -> tuple[tuple[str, type[ctypes.c_double]], ...]:
    return tuple((name, ctypes.c_double) for name in names.split())


class Estimates(ctypes.Structure):
    """Estimates of a camera, as `Estimates` in `follow.h`; NaN if they are not known."""

    _fields_ = (
        *_doubles("sigma_px noise contrast print_contrast"),
        ("ratio_sums", ctypes.c_double * 2),
        ("ratio_boxes", ctypes.c_double),
    )


class VerificationLimits(ctypes.Structure):
    """Limits of verification, as in `follow.h`; `photometric.verify` has their reasons."""

    _fields_ = (
        *_doubles("wrong_cell_share wrong_cell_sigmas wrong_cell_limit strong_cell_limit weak_cell_share"),
        *_doubles("min_contrast max_white max_cell_noise max_anisotropy max_keystone max_blur_cells"),
        *_doubles("max_last_step_px min_cell_px min_area_share noise_factor model_share cell_model_share"),
        *_doubles("sharp_blur_cells max_processed_noise wrong_bits min_print_share min_divisor_contrast"),
        *_doubles("first_log_sigma last_log_sigma"),
        ("own_cell", ctypes.c_void_p),
        ("square", ctypes.c_void_p),
        ("table_size", ctypes.c_int32),
        ("is_strong", ctypes.c_int32),
    )


class FollowConstants(ctypes.Structure):
    """Constants of following; `follow.h` has the same fields, and says which module defines each."""

    _fields_ = (
        *_doubles("reach_sides max_log_growth"),
        *_doubles("max_side_px max_log_blur_difference"),
        *_doubles("streak_pixels significant min_streak_px2 streak_ridge"),
        *_doubles("outlier_share outlier_sigmas rounding_noise median_difference learning_rate forgotten"),
        *_doubles("significant_ratio_error min_ratio max_ratio"),
        ("looks", AppearanceConstants),
        ("blur", BlurConstants),
        ("verification", VerificationLimits),
        ("max_missed", ctypes.c_int32),
        ("streak_markers", ctypes.c_int32),
        ("saturation_margin", ctypes.c_int32),
        ("min_unsaturated_pixels", ctypes.c_int32),
    )


class FollowRequestStructure(ctypes.Structure):
    """Image, tracks and estimates of a camera; `FollowRequest` in `follow.h` has the same fields."""

    _fields_ = (
        ("image", ctypes.c_void_p),
        ("tracks", ctypes.c_void_p),
        ("cells", ctypes.c_void_p),
        ("fit_constants", ctypes.POINTER(FitConstants)),
        ("constants", ctypes.POINTER(FollowConstants)),
        ("height", ctypes.c_int64),
        ("width", ctypes.c_int64),
        ("count", ctypes.c_int64),
        ("time_s", ctypes.c_double),
        ("noise", ctypes.c_double),
        ("estimates", Estimates),
        ("n", ctypes.c_int32),
        ("max_steps", ctypes.c_int32),
    )


class FollowResultsStructure(ctypes.Structure):
    """Results of following; `FollowResults` in `follow.h` has the same fields."""

    _fields_ = (
        *(
            (name, ctypes.c_void_p)
            for name in (
                *("rows", "should_be_seen", "starts", "blurs", "fits", "cell_means"),
                *("plane", "tracks", "detections"),
            )
        ),
        ("estimates", Estimates),
        ("here", ctypes.c_int64),
        ("track_count", ctypes.c_int64),
    )


@dataclass(frozen=True)
class FollowRequest:
    """N tracks of a camera, at least one, to be followed into an image.

    Attributes:
        image: grey, (height, width).
        tracks: (N,) of `TRACK`, ids ascending.
        cells: (N, n + 2, n + 2) 1 where a cell is black, 0 where it is white and on the ground around.
        plane: (1,) of `PLANE`, the known one.
        estimates: of the camera.
        fit_constants: of the fit.
        constants: of following.
        time_s: time of the image.
        noise: standard deviation of a pixel as far as it is known, grey levels.
        max_steps: most steps of the fit.
    """

    image: Image
    tracks: npt.NDArray[np.void]
    cells: Floats
    plane: npt.NDArray[np.void]
    estimates: Estimates
    fit_constants: FitConstants
    constants: FollowConstants
    time_s: float
    noise: float
    max_steps: int

    def structure(self) -> FollowRequestStructure:
        """Return the structure of the request, which is valid as long as its arrays.

        Raises:
            InputError: an array has another type, shape or memory layout.
        """
        count, sides = len(self.tracks), self.cells.shape[1]
        check_plane("image", self.image, None)
        return FollowRequestStructure(
            self.image.ctypes.data,
            address("tracks", self.tracks, TRACK, (count,)),
            address("cells", self.cells, np.float32, (count, sides, sides)),
            ctypes.pointer(self.fit_constants),
            ctypes.pointer(self.constants),
            *self.image.shape,
            count,
            self.time_s,
            self.noise,
            self.estimates,
            sides - 2,
            self.max_steps,
        )


@dataclass(frozen=True)
class FollowResults:
    """Results of following N tracks, of which M are in view.

    Attributes:
        rows: (M,) indices of the tracks in view.
        should_be_seen: (N,) whether the image should show the marker.
        starts: (M,) of `HOMOGRAPHY`, where the markers in view are predicted.
        blurs: (M,) standard deviations of the blurs that were assumed, in marker sides.
        fits: (M,) of `FIT`; valid unless the markers were not fitted, as the next ones.
        cell_means: (M, n, n) mean residual over each cell, grey levels.
        plane: (1,) of `PLANE`, the one found.
        tracks: (K,) of `TRACK` after the image; valid only if all is as usual, as the next ones.
        detections: (M,) of `DETECTION`.
        estimates: of the camera after the image.
    """

    rows: IntArray
    should_be_seen: IntArray
    starts: npt.NDArray[np.void]
    blurs: Array
    fits: npt.NDArray[np.void]
    cell_means: Array
    plane: npt.NDArray[np.void]
    tracks: npt.NDArray[np.void]
    detections: npt.NDArray[np.void]
    estimates: Estimates

    @classmethod
    def room_for(cls, request: FollowRequest) -> tuple[Self, FollowResultsStructure]:
        """Return results with room for all tracks of a request, and the structure of their memory."""
        count, n = len(request.tracks), request.cells.shape[1] - 2
        rows, seen = np.empty((2, count), dtype=np.int64)
        starts, fits = np.empty(count, dtype=HOMOGRAPHY), np.empty(count, dtype=FIT)
        blurs, means = np.empty(count), np.empty((count, n, n))
        tracks, detections = np.empty(count, dtype=TRACK), np.empty(count, dtype=DETECTION)
        plane = request.plane.copy()
        memory = rows, seen, starts, blurs, fits, means, plane, tracks, detections
        address("plane", plane, PLANE, (1,))
        structure = FollowResultsStructure(*(array.ctypes.data for array in memory))
        return cls(rows, seen, starts, blurs, fits, means, plane, tracks, detections, Estimates()), structure

    def cut(self, structure: FollowResultsStructure) -> "FollowResults":
        """Return the results with the numbers of rows that the library wrote."""
        here = int(structure.here)
        return FollowResults(
            self.rows[:here],
            self.should_be_seen,
            self.starts[:here],
            self.blurs[:here],
            self.fits[:here],
            self.cell_means[:here],
            self.plane,
            self.tracks[: structure.track_count],
            self.detections[:here],
            structure.estimates,
        )
