"""The size of the shape, in marker sides: free above a smallest spacing, or given.

In the paper any size will do. Robots with bodies need a floor, which keeps the scale of the fitted similarity
above a bound (`Similarity.resized`). The fit stays a least-squares fit, and V a cost that falls;
docs/bodies.md has the proof of convergence with an active floor.

Units must mean the same length by a marker side: otherwise each would hold the robots that two units share at
a distance of its own. Each unit therefore averages its own measurement with those that its neighbours report,
converted to its own pixels by the robots that both see.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.geometry import to_complex
from skyherd.messages import Detections, UnitReport
from skyherd.messages.checks import check_numbers

LEAK = 0.05
"""Weight of a unit's own measurement in each step of the average. Chosen: without it nothing holds the common
mean, which would drift by rounding and noise; at twice the value, units that measure differently agree half
as well, since their remaining difference is in proportion to it."""


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
        """Whether any size will do, as in the paper."""
        return self.min_sides == 0 and self.max_sides == np.inf

    def scales(self, template: Template, side_px: float) -> tuple[float, float]:
        """Least and greatest scale of the similarity, image pixels for a template pixel.

        Args:
            template: the shape.
            side_px: side of a marker in the image; where it is 0, as not known, there are no bounds.
        """
        if self.is_free or not side_px:
            return 0.0, np.inf
        side_in_spacings = side_px / template.spacing_px
        return self.min_sides * side_in_spacings, self.max_sides * side_in_spacings


@dataclass
class SideConsensus:
    """One unit's estimate of a marker's side in its image, by consensus with its neighbours.

    Let m be the logarithm of the geometric mean of the sides in view and s_k the logarithm of what neighbour
    k reports, converted to the unit's own pixels. The estimate s follows

        s ← m + (1 - LEAK) (mean{s, s_k} - m).

    Attributes:
        excess: s - m, the logarithm of the factor by which the consensus differs from the measurement.
    """

    excess: float = 0.0

    def update(self, seen: Detections, reports: Sequence[UnitReport]) -> float:
        """The side of a marker in this image, px; 0 while no marker is seen.

        Args:
            seen: detections in the unit's own image.
            reports: the newest reports of other units; those that report no side are left out.
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
    """Logarithm of the side that a neighbour reports, in the unit's own pixels.

    The scale from its image to the own one is the ratio of the RMS distances from the centroid of the robots
    that both see; NaN if these are fewer than two.
    """
    _, here, there = np.intersect1d(seen.ids, report.ids, assume_unique=True, return_indices=True)
    if here.size < 2:
        return float("nan")
    own, theirs = to_complex(seen.centers_px[here]), to_complex(report.points_px[there])
    spread_own, spread_theirs = np.abs(own - own.mean()), np.abs(theirs - theirs.mean())
    ratio = np.vdot(spread_own, spread_own) / np.vdot(spread_theirs, spread_theirs)
    return float(np.log(report.side_px) + np.log(ratio) / 2)
