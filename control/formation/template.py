"""The template image: the shape to form, as one image point for each robot (paper, Section III)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import pdist

from skyherd.control.formation.similarity import COINCIDENT
from skyherd.errors import DegenerateSetError, InputError
from skyherd.geometry import ComplexArray, IntArray, to_complex, to_points


@dataclass(frozen=True)
class Template:
    """Robot ids (N,), ascending, and their points (N,) in the template image as `u + iv`, px."""

    ids: IntArray
    points_px: ComplexArray

    def __post_init__(self) -> None:
        ids = np.array(self.ids, dtype=np.int64)
        points = np.array(self.points_px, dtype=np.complex128)
        if ids.shape != points.shape or ids.ndim != 1:
            raise InputError(
                "template", f"{ids.shape} ids, {points.shape} points", "one point for each robot id"
            )
        if ids.size < 2:
            raise InputError("template", f"{ids.size} robots", "at least two, since fewer make no shape")
        if np.unique(ids).size != ids.size:
            raise InputError("template", f"repeated ids in {ids.tolist()}", "each robot once")
        if np.abs(points - points.mean()).max() <= COINCIDENT * np.abs(points).max():
            raise DegenerateSetError(
                "template: all points coincide; a shape needs at least two distinct points"
            )
        order = np.argsort(ids)
        ids, points = ids[order], points[order]
        ids.setflags(write=False)
        points.setflags(write=False)
        object.__setattr__(self, "ids", ids)
        object.__setattr__(self, "points_px", points)

    @classmethod
    def from_image_points(cls, ids: npt.ArrayLike, points_px: npt.ArrayLike) -> "Template":
        """Template of points (N, 2) in image sense: u right, v down."""
        return cls(np.asarray(ids), to_complex(points_px))

    @classmethod
    def from_ground_points(cls, ids: npt.ArrayLike, points: npt.ArrayLike) -> "Template":
        """Template of points (N, 2) as seen on a map, x right and y up; an image has v down."""
        return cls(np.asarray(ids), to_complex(points).conj())

    @cached_property
    def spacing_px(self) -> float:
        """Distance between its two nearest points."""
        return float(pdist(to_points(self.points_px)).min())

    @cached_property
    def members(self) -> frozenset[int]:
        """The robots, as a set."""
        return frozenset(self.ids.tolist())

    def points_of(self, ids: IntArray) -> ComplexArray:
        """Template points of the robots `ids`, all of which must be in the template."""
        return self.points_px[np.searchsorted(self.ids, ids)]
