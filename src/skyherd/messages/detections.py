"""Markers that one unit's detector found in one image, and the unit of length for rules on images."""

from collections import Counter
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError, MessageError
from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.messages.checks import check_time, shown
from skyherd.messages.frozen_arrays import freeze, freeze_ids, freeze_image_size
from skyherd.messages.ids import among
from skyherd.messages.short_repr import short_repr

if TYPE_CHECKING:
    import pandas

CORNER_COLUMNS = tuple(f"corner{k}_{axis}_px" for k in range(4) for axis in "uv")
"""Table columns of the four corners, the two front ones first."""

STD_COLUMNS = ("std_u_px", "std_v_px", "std_heading_deg")
"""Table columns of the standard deviations; empty where the detector does not state them."""

MARKER_COLUMNS = ("id", "u_px", "v_px", "heading_deg", "side_px", *STD_COLUMNS, "quality")
"""Table columns of a marker, except for its corners."""

MAX_SHOWN_IDS = 8
"""Most ids in the representation of detections. Chosen: it fits on a line."""


class Quality(IntEnum):
    """Kind of a marker's measurement; a greater value is a better one.

    Attributes:
        CORNERS: by its corners or edges. Detectors of other libraries report nothing else.
        ROBUST: by a fit to the pixels that agree on a pose; others, as under glare or salt, are left out.
        PHOTOMETRIC: by a fit to all of its pixels whose residual is the image's noise.
    """

    CORNERS = 0
    ROBUST = 1
    PHOTOMETRIC = 2


QUALITIES = frozenset(map(int, Quality))
"""Values of `Quality`."""


def _no_qualities() -> IntArray:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Detection:
    """One marker found in an image; an item of `Detections`, with its conventions.

    Attributes:
        id: id of the marker.
        center_px: (2,) centre.
        heading_rad: direction of the robot's forward axis in the image, from +u to +v.
        side_px: side of the black square.
        corners_px: (4, 2) corners of the black square: front left, front right, back right, back left.
        covariance: (3, 3) of (u, v, heading), in px², px·rad and rad²; all zero if unknown.
        quality: kind of the measurement.
    """

    id: int
    center_px: Array
    heading_rad: float
    side_px: float
    corners_px: Array
    covariance: Array
    quality: Quality

    __repr__ = short_repr

    def columns(self) -> dict[str, Any]:
        """Return the values of `MARKER_COLUMNS`; unknown standard deviations are None."""
        known = self.covariance.any()
        stds = np.sqrt(np.diag(self.covariance)) * (1.0, 1.0, np.degrees(1.0)) if known else [None] * 3
        place = self.id, *self.center_px, float(np.degrees(self.heading_rad)), self.side_px
        return dict(zip(MARKER_COLUMNS, (*place, *stds, self.quality.name.lower()), strict=True))


@dataclass(frozen=True)
class Detections:
    """Markers found in one image: the only view of the world that `control` has.

    It contains image quantities only: no focal length, height, camera pose or metre. All points are in
    pixels, u right and v down, with integers at pixel centres.

    It is a sequence of markers: `for marker in detections` and `detections[0]` give each as a `Detection`.
    A slice, a mask (N,) or an array of rows gives the `Detections` of these rows.

    Attributes:
        unit_id: the aerial unit whose image it is.
        time_s: time of the image.
        image_size_px: (2,) width and height of the image.
        ids: (N,) ids of the markers; an id may occur twice, see `repeated`.
        centers_px: (N, 2) centres of the markers.
        headings_rad: (N,) direction of each robot's forward axis in the image, from +u to +v.
        sides_px: (N,) sides of the black squares, positive.
        corners_px: (N, 4, 2) corners of the black squares, in the order of `skyherd.geometry.SQUARE_CORNERS`:
            front left, front right, back right, back left.
        covariances: (N, 3, 3) covariances of (u, v, heading), in px², px·rad and rad²; all zero if the
            detector reports none.
        qualities: (N,) values of `Quality`; all `CORNERS` if left out.

    Raises:
        MessageError: a shape is wrong, a value is not finite, a side not positive, or a quality unknown.
    """

    unit_id: int
    time_s: float
    image_size_px: Array
    ids: IntArray
    centers_px: Array
    headings_rad: Array
    sides_px: Array
    corners_px: Array
    covariances: Array
    qualities: IntArray = field(default_factory=_no_qualities)

    def __post_init__(self) -> None:
        check_time(self)
        n = freeze_ids(self, "ids", repeats=True)
        freeze_image_size(self)
        freeze(self, "centers_px", (n, 2))
        freeze(self, "headings_rad", (n,))
        freeze(self, "sides_px", (n,))
        freeze(self, "corners_px", (n, 4, 2))
        freeze(self, "covariances", (n, 3, 3))
        if n and not np.size(self.qualities):
            object.__setattr__(self, "qualities", np.full(n, Quality.CORNERS))
        freeze(self, "qualities", (n,), integer=True)
        if not QUALITIES.issuperset(self.qualities.tolist()):
            raise MessageError("Detections.qualities", shown(self.qualities.tolist()), "0, 1 or 2")
        if (self.sides_px <= 0).any():
            raise MessageError("Detections.sides_px", shown(self.sides_px.tolist()), "positive sides")

    def __len__(self) -> int:
        return int(self.ids.size)

    def __iter__(self) -> Iterator[Detection]:
        return (self[row] for row in range(len(self)))

    @overload
    def __getitem__(self, rows: int | np.integer[Any]) -> Detection: ...

    @overload
    def __getitem__(self, rows: slice | npt.ArrayLike) -> "Detections": ...

    def __getitem__(self, rows: slice | npt.ArrayLike) -> "Detection | Detections":
        if not isinstance(rows, int | np.integer):
            return self._kept(rows if isinstance(rows, slice) else np.asarray(rows))
        return Detection(
            id=int(self.ids[rows]),
            center_px=self.centers_px[rows],
            heading_rad=float(self.headings_rad[rows]),
            side_px=float(self.sides_px[rows]),
            corners_px=self.corners_px[rows],
            covariance=self.covariances[rows],
            quality=Quality(self.qualities[rows]),
        )

    def __repr__(self) -> str:
        ids = ", ".join(map(str, self.ids[:MAX_SHOWN_IDS])) + ", …" * (len(self) > MAX_SHOWN_IDS)
        width, height = self.image_size_px
        return (
            f"Detections({len(self)} marker(s){': ' if len(self) else ''}{ids}; {width:.0f}x{height:.0f} px, "
            f"unit {self.unit_id}, {self.time_s:.6g} s)"
        )

    def to_dataframe(self) -> "pandas.DataFrame":
        """Return a pandas table with a row for each marker, as in the tables of `skyherd detect`.

        The columns are `unit_id`, `time_s`, `id`, `u_px`, `v_px`, `heading_deg`, `side_px`, the standard
        deviations `std_u_px`, `std_v_px` and `std_heading_deg` (NaN if unknown), `quality`, and the corners
        `corner0_u_px` to `corner3_v_px`.

        Raises:
            InputError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            where = "Detections.to_dataframe"
            raise InputError(where, "pandas is not installed", "pip install pandas") from None
        table = pandas.DataFrame([marker.columns() for marker in self], columns=MARKER_COLUMNS)
        table.insert(0, "unit_id", self.unit_id)
        table.insert(1, "time_s", self.time_s)
        table[list(CORNER_COLUMNS)] = self.corners_px.reshape(-1, len(CORNER_COLUMNS))
        numbers = set(MARKER_COLUMNS) - {"id", "quality"}
        return table.astype({"id": int, **dict.fromkeys(numbers, float)})  # also of None and without rows

    @cached_property
    def repeated_ids(self) -> frozenset[int]:
        """Ids that occur more than once, which are ambiguous."""
        ids = self.ids.tolist()
        if len(set(ids)) == len(ids):  # the usual case
            return frozenset()
        return frozenset(marker for marker, count in Counter(ids).items() if count > 1)

    @property
    def repeated(self) -> BoolArray:
        """Mask (N,) of the detections with a repeated id."""
        return among(self.ids, self.repeated_ids)

    @cached_property
    def centred(self) -> Array:
        """Centres (N, 2) relative to the image centre, in halves of the image's shorter side."""
        points = centred(self.centers_px, self.image_size_px)
        points.setflags(write=False)
        return points

    @cached_property
    def centre_distances(self) -> Array:
        """Distances (N,) from the image centre, in halves of the image's shorter side."""
        return _lengths(self.centred)

    def unambiguous(self) -> "Detections":
        """Return the detections whose ids occur once."""
        return self.without(self.repeated_ids)

    def without(self, ids: AbstractSet[int] | npt.ArrayLike) -> "Detections":
        """Return the detections with none of the `ids`, in the present order."""
        if isinstance(ids, AbstractSet) and ids.isdisjoint(self.ids.tolist()):
            return self
        drop = among(self.ids, ids)
        return self._kept(~drop) if drop.any() else self

    def select(self, ids: AbstractSet[int] | npt.ArrayLike) -> "Detections":
        """Return the detections with one of the `ids`, in the present order."""
        if isinstance(ids, AbstractSet) and ids >= set(self.ids.tolist()):
            return self
        keep = among(self.ids, ids)
        return self if keep.all() else self._kept(keep)

    def of_quality(self, least: Quality) -> "Detections":
        """Return the detections that were measured at least as well as `least`."""
        keep = self.qualities >= least
        return self if keep.all() else self._kept(keep)

    def _kept(self, keep: BoolArray | IntArray | slice) -> "Detections":
        """Return the detections of a mask (N,), of rows (K,), or of a slice."""
        return Detections(
            unit_id=self.unit_id,
            time_s=self.time_s,
            image_size_px=self.image_size_px,
            ids=self.ids[keep],
            centers_px=self.centers_px[keep],
            headings_rad=self.headings_rad[keep],
            sides_px=self.sides_px[keep],
            corners_px=self.corners_px[keep],
            covariances=self.covariances[keep],
            qualities=self.qualities[keep],
        )


def centred(points_px: Array, image_size_px: Array) -> Array:
    """Return image points (N, 2), px, relative to the image centre, in halves of the image's shorter side.

    In this unit of length the circle of radius 1 touches the nearer borders of every image. A rule on
    distances from the image centre is therefore the same for every camera.

    Args:
        points_px: (N, 2) image points.
        image_size_px: (2,) width and height of the image.
    """
    return np.asarray((points_px - (image_size_px - 1) / 2) / (min(image_size_px.tolist()) / 2))


def centre_distances(points_px: Array, image_size_px: Array) -> Array:
    """Return distances (N,) of image points (N, 2), px, from the image centre, read-only; see `centred`."""
    return _lengths(centred(points_px, image_size_px))


def _lengths(points: Array) -> Array:
    """Return the lengths (N,) of vectors (N, 2), read-only."""
    lengths = np.asarray(np.linalg.norm(points, axis=1))
    lengths.setflags(write=False)
    return lengths
