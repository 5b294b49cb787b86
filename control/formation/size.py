"""How large the shape may be: free above a smallest spacing, or as wished, in marker sides.

Units must mean the same by a marker side, or each would hold the robots they share at a distance of its own.
What each measures is averaged with what its neighbours measure, brought to its own pixels by the distances
between robots that both see.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.geometry import to_complex
from skyherd.messages import Detections, UnitReport

LEAK = 0.05
"""Share of its own measurement in each step of the average, which keeps the common mean from drifting."""


@dataclass(frozen=True)
class SizeRule:
    """Bounds on the distance between the two nearest points of the shape, in marker sides.

    Attributes:
        least_sides: the size is free above this; 0 for no bound.
        most_sides: the size is free below this; equal to `least_sides` for a wanted size.
    """

    least_sides: float = 0.0
    most_sides: float = np.inf

    @property
    def is_free(self) -> bool:
        """Whether any size will do, as in the paper."""
        return self.least_sides == 0 and self.most_sides == np.inf

    def scales(self, template: Template, side_px: float) -> tuple[float, float]:
        """Bounds of the similarity's scale, image pixels a template pixel."""
        if self.is_free or not side_px:
            return 0.0, np.inf
        side_in_spacings = side_px / template.spacing_px
        return self.least_sides * side_in_spacings, self.most_sides * side_in_spacings


@dataclass
class Yardstick:
    """One unit's pixels for a marker side, as agreed with its neighbours.

    With m the mean side of the markers in view and s_k what neighbour k reports, all as logarithms and in
    the unit's own pixels,

        s ← m + (1 - LEAK) (mean{s, s_k} - m).

    Attributes:
        excess: s - m, what the agreement adds to the unit's own measurement.
    """

    excess: float = 0.0

    def update(self, seen: Detections, reports: Sequence[UnitReport]) -> float:
        """A marker side in this image, px; 0 while none is seen."""
        if not len(seen):
            return 0.0
        own = float(np.log(seen.sides_px).mean())
        told = [_told(seen, report) - own for report in reports if report.side_px > 0]
        told = [excess for excess in told if np.isfinite(excess)]
        if told:
            self.excess = (1 - LEAK) * float(np.mean([self.excess, *told]))
        return float(np.exp(own + self.excess))


def _told(seen: Detections, report: UnitReport) -> float:
    """Logarithm of a neighbour's side in the own pixels; NaN if too few robots are in both views."""
    _, here, there = np.intersect1d(seen.ids, report.ids, assume_unique=True, return_indices=True)
    if here.size < 2:
        return float("nan")
    own, theirs = to_complex(seen.centers_px[here]), to_complex(report.points_px[there])
    spread_own, spread_theirs = np.abs(own - own.mean()), np.abs(theirs - theirs.mean())
    ratio = np.vdot(spread_own, spread_own) / np.vdot(spread_theirs, spread_theirs)
    return float(np.log(report.side_px) + np.log(ratio) / 2)
