"""Size of the shape, in marker sides: free above a minimum spacing, or given.

In the paper the size is free. Robots with bodies need a minimum size, which bounds the scale of the fitted
similarity from below (`Similarity.resized`). The fit remains a least-squares fit, and the Lyapunov function V
still decreases. docs/bodies.md has the proof of convergence with an active bound.

Units need a common marker side. Otherwise each would hold the robots that two units share at a different
distance. Each unit therefore averages its own measurement with those of its neighbours. These are converted
to its own pixels by means of the robots that both see.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.geometry import to_complex
from skyherd.messages import Detections, UnitReport
from skyherd.messages.checks import check_numbers

LEAK = 0.05
"""Weight of a unit's own measurement in each step of the average. Chosen: without it the common mean drifts
by rounding and noise; twice the value doubles the remaining disagreement of units."""


@dataclass(frozen=True)
class SizeRule:
    """Bounds on the size of the shape, as the distance between its two nearest points in marker sides.

    Attributes:
        min_sides: lower bound; 0 for none.
        max_sides: upper bound; equal to `min_sides` for a given size, infinite for none.
    """

    min_sides: float = 0.0
    max_sides: float = np.inf

    def __post_init__(self) -> None:
        check_numbers(self, not_negative=("min_sides", "max_sides"), endless=("max_sides",))

    @property
    def is_free(self) -> bool:
        """True if any size is allowed, as in the paper."""
        return self.min_sides == 0 and self.max_sides == np.inf

    def scales(self, template: Template, side_px: float) -> tuple[float, float]:
        """Return the minimum and maximum scale of the similarity, image pixels per template pixel.

        Args:
            template: the shape.
            side_px: side of a marker in the image; 0, if unknown, gives no bounds.
        """
        if self.is_free or not side_px:
            return 0.0, np.inf
        side_in_spacings = side_px / template.spacing_px
        return self.min_sides * side_in_spacings, self.max_sides * side_in_spacings


@dataclass
class SideConsensus:
    """Estimate of one unit of a marker's side in its image, by consensus with its neighbours.

    Let m be the logarithm of the geometric mean of the sides in view. Let s_k be the logarithm of the side
    that neighbour k reports, converted to the unit's own pixels. The estimate s follows

        s ← m + (1 - LEAK) (mean{s, s_k} - m).

    Attributes:
        excess: s - m, the logarithm of the ratio of consensus to measurement.
    """

    excess: float = 0.0

    def update(self, seen: Detections, reports: Sequence[UnitReport]) -> float:
        """Update and return the side of a marker in this image, px; 0 while no marker is visible.

        Args:
            seen: detections in the unit's own image.
            reports: the newest reports of other units; reports without a side are ignored.
        """
        if not len(seen):
            return 0.0
        own = float(np.log(seen.sides_px).mean())
        received = [_log_side_here(seen, report) - own for report in reports if report.side_px > 0]
        received = [excess for excess in received if np.isfinite(excess)]
        if received:
            self.excess = (1 - LEAK) * float(np.mean([self.excess, *received]))
        return float(np.exp(own + self.excess))


def _log_side_here(seen: Detections, report: UnitReport) -> float:
    """Return the logarithm of the side that a neighbour reports, in the unit's own pixels.

    The scale between the two images is the ratio of the RMS distances of the common robots from their
    centroid. The result is NaN with fewer than two common robots.
    """
    _, here, there = np.intersect1d(seen.ids, report.ids, assume_unique=True, return_indices=True)
    if here.size < 2:
        return float("nan")
    own, theirs = to_complex(seen.centers_px[here]), to_complex(report.points_px[there])
    spread_own, spread_theirs = np.abs(own - own.mean()), np.abs(theirs - theirs.mean())
    ratio = np.vdot(spread_own, spread_own) / np.vdot(spread_theirs, spread_theirs)
    return float(np.log(report.side_px) + np.log(ratio) / 2)
