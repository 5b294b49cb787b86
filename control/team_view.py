"""Places of a team in one image, and its motion between two images."""

from dataclasses import dataclass

import numpy as np

from skyherd.control.formation.similarity import fit_similarity
from skyherd.errors import DegenerateSetError
from skyherd.geometry import Array, BoolArray, ComplexArray


@dataclass(frozen=True)
class TeamView:
    """Places of the team in one image.

    Attributes:
        time_s: time of the image.
        points_px: (N,) places, `u + iv`; 0 if not seen.
        seen: (N,) mask of the robots seen.
        side_px: median side of the markers, px.
    """

    time_s: float
    points_px: ComplexArray
    seen: BoolArray
    side_px: float

    def moved_sides(self, before: "TeamView") -> Array:
        """Return the motion (N,) in the image since another one, marker sides; 0 if not seen in both."""
        both = self.seen & before.seen
        return np.where(both, np.abs(self.points_px - before.points_px), 0.0) / self.side_px

    def relative_sides(self, before: "TeamView", use: BoolArray) -> Array:
        """Return the motion (N,), marker sides, of the robots in `use` relative to each other; else 0.

        The motion of the camera is removed as a similarity, fitted again without the quarter of the robots
        that deviate most. Up to two robots are compared in the image itself.
        """
        moved = np.zeros(self.seen.size)
        both = np.flatnonzero(self.seen & before.seen & use)
        source, target = before.points_px[both], self.points_px[both]
        if both.size <= 2:
            moved[both] = np.abs(target - source)
        else:
            residuals = _residuals(source, target, slice(None))
            keep = residuals <= np.sort(residuals)[-1 - both.size // 4]
            moved[both] = _residuals(source, target, keep)
        return np.asarray(moved / self.side_px)


def _residuals(source: ComplexArray, target: ComplexArray, keep: BoolArray | slice) -> Array:
    """Return distances (N,) of targets (N,) from sources (N,) under the similarity of those in `keep`."""
    try:
        return np.abs(target - fit_similarity(source[keep], target[keep])(source))
    except DegenerateSetError:
        return np.abs(target - source)
