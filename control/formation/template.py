"""Template image: the shape to form, as one image point for each robot (paper, Section III)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import pdist

from skyherd.control.formation.similarity import COINCIDENT
from skyherd.errors import DegenerateSetError, InputError
from skyherd.geometry import ComplexArray, IntArray, to_complex, to_points
from skyherd.messages import rows_of
from skyherd.messages.checks import check_ids, shown
from skyherd.messages.short_repr import short_repr

MAX_PX = 1e9
"""Maximum coordinate of a template's point. Chosen: beyond any image and any map in metres, and far below
overflow of its square."""


@dataclass(frozen=True)
class Template:
    """Shape to form: p' of the paper, one point for each robot; ids may be given in any order.

    The template is an image as well: its points have u right and v down. Similarities between it and a
    camera's image are therefore proper, without reflection. Only the shape matters, not position, rotation or
    scale.

    Attributes:
        ids: (N,) ids of the robots, in ascending order.
        points_px: (N,) their points in the template image as `u + iv`, in the order of `ids`.

    Raises:
        InputError: the numbers of ids and points differ, or are below two. An id is repeated, negative or not
            an integer, or a point is not finite.
        DegenerateSetError: all points coincide.
    """

    ids: IntArray
    points_px: ComplexArray

    __repr__ = short_repr

    def __post_init__(self) -> None:
        ids = check_ids(self.ids, "template")
        try:
            points = np.array(self.points_px, dtype=np.complex128)
        except (ValueError, OverflowError):
            raise InputError("template", shown(self.points_px), "a complex number for each robot") from None
        if ids.shape != points.shape or ids.ndim != 1:
            raise InputError(
                "template", f"{ids.shape} ids, {points.shape} points", "one point for each robot id"
            )
        if ids.size < 2:
            raise InputError("template", f"{ids.size} robots", "at least two, since fewer make no shape")
        if np.unique(ids).size != ids.size:
            raise InputError("template", f"repeated ids in {shown(ids.tolist())}", "each robot once")
        if not (np.abs(points) <= MAX_PX).all():
            raise InputError("template", "a point that is not finite", f"coordinates up to {MAX_PX:g}")
        if np.abs(points - points.mean()).max() <= COINCIDENT * np.abs(points).max():
            raise DegenerateSetError("template", "all points coincide", "at least two distinct points")
        order = np.argsort(ids)
        ids, points = ids[order], points[order]
        ids.setflags(write=False)
        points.setflags(write=False)
        object.__setattr__(self, "ids", ids)
        object.__setattr__(self, "points_px", points)

    @classmethod
    def from_image_points(cls, ids: npt.ArrayLike, points_px: npt.ArrayLike) -> "Template":
        """Return a template of the points (N, 2) of an image: u right, v down."""
        return cls(check_ids(ids, "template"), _complex_points(points_px))

    @classmethod
    def from_ground_points(cls, ids: npt.ArrayLike, points: npt.ArrayLike) -> "Template":
        """Return a template of the points (N, 2) of a map: x right, y up; the sense of y is reversed."""
        return cls(check_ids(ids, "template"), _complex_points(points).conj())

    @cached_property
    def spacing_px(self) -> float:
        """Distance between the two nearest points of the template, in its pixels."""
        return float(pdist(to_points(self.points_px)).min())

    @cached_property
    def radius_px(self) -> float:
        """RMS distance of the points from their mean, in pixels of the template."""
        return float(np.sqrt((np.abs(self.points_px - self.points_px.mean()) ** 2).mean()))

    @cached_property
    def members(self) -> frozenset[int]:
        """Ids of the robots as a set."""
        return frozenset(self.ids.tolist())

    def points_of(self, ids: IntArray) -> ComplexArray:
        """Return points (M,) of the robots `ids` (M,).

        Raises:
            MessageError: a robot is not in the template.
        """
        return self.points_px[rows_of(self.ids, ids)]


def _complex_points(points: npt.ArrayLike) -> ComplexArray:
    """Return points (N, 2) as complex numbers (N,).

    Raises:
        InputError: they are not a list of pairs of numbers.
    """
    try:
        pairs = np.asarray(points, dtype=float)
    except (TypeError, ValueError, OverflowError):
        pairs = np.zeros(0)
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise InputError("template", f"points {shown(points)}", "a pair of numbers for each robot")
    return to_complex(pairs)
