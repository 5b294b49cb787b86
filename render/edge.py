"""Edge spread function of lens and pixel as a table, and the limits of its use.

The lens blurs light by a Gaussian of standard deviation psf, and a square pixel collects it. At a signed
distance d from a straight edge, whose normal makes an angle α with the image's axes, a pixel receives

    S(d) = ∫∫ Φ((d - a cos α - b sin α) / psf) da db   over the unit square,

with Φ the normal distribution. With total variance `σ² = psf² + 1/12` this is nearly Φ(d / σ). The square is
no Gaussian: the difference is up to 0.3 grey levels at a psf of 0.5 px.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from skyherd.markers.blur_model import total_sigma_px

Float = npt.NDArray[np.float32]
"""Numbers of single precision: half the memory, and exact to 1e-4 px in the largest image."""

REACH = 4.0
"""Half the length of the table, σ; the margin of a shape. *Derived*: `200 Φ(-4)` is 0.006 grey levels of
200."""

FELT = 3.4
"""Distance in σ beyond which a line of a grid is ignored. *Derived*: `200 Φ(-3.4)` is 0.07 grey levels of
200. More lines per pixel take more time."""

SQUARE = 1e-3
"""Correlation of the two axes below which a corner is the product of its edges. *Derived*: `200 ρ φ(0)²` is
0.03 grey levels of 200."""

SLANTED = 0.35
"""Correlation ρ above which the integral over it has two nodes. *Chosen*: the midpoint rule is exact to 0.1
grey levels of 200 at 0.3; two nodes take twice the time."""

BOXY = 0.03
"""Fourth cumulant of the pixel, over σ⁴, below which corners ignore it. *Derived*: at most 0.1 grey levels of
200."""

SAMPLES = 4096
"""Entries of the table for each direction. *Derived*: half the distance of two entries times the steepest
slope, `200 φ(0) REACH / SAMPLES`, is 0.08 grey levels of 200. Twice as many do not fit the L1 cache."""

DIRECTIONS = 5
"""Directions of an edge that have tables, evenly in cos 4α from an image axis to the diagonal. *Chosen*: S
differs by 0.3 grey levels between the two ends, so that the nearest of five is exact to 0.04."""

SHARPEST_PX = 0.05
"""Least standard deviation of the lens's blur, px; sharper lenses are drawn with it. *Chosen*: the pixel's
own 0.29 px hides it, and the quadrature over the pixel needs some blur."""


@dataclass(frozen=True)
class EdgeSpread:
    """The function S for one lens, as a table.

    Attributes:
        sigma_px: σ of lens and pixel together.
        table: (DIRECTIONS * SAMPLES,) float32, S at distances from -REACH to REACH σ.
    """

    sigma_px: float
    table: Float

    @property
    def kurtosis(self) -> float:
        """Fourth cumulant of a uniform distribution one pixel wide, -1/120 px⁴, over σ⁴."""
        return -1.0 / 120.0 / self.sigma_px**4


PER_SIGMA = (SAMPLES / 2 - 1) / REACH
"""Table entries to one σ. *Derived*: the table runs from -REACH to REACH."""


@lru_cache(maxsize=64)
def edge_spread(psf_px: float) -> EdgeSpread:
    """Return the edge spread of a lens whose blur has the standard deviation `psf_px`, px.

    By Gauss-Legendre quadrature over the pixel's square. Tables of the last 64 lenses are kept.
    """
    sigma = total_sigma_px(psf_px)
    node, weight = np.polynomial.legendre.leggauss(6 if psf_px > 0.3 else 24)
    distance = (np.arange(SAMPLES) - SAMPLES // 2)[:, None, None] / PER_SIGMA * sigma
    rows = []
    for alpha in np.arccos(np.linspace(1, -1, DIRECTIONS)) / 4:
        inside = (node[:, None] * np.cos(alpha) + node[None, :] * np.sin(alpha)) / 2
        spread = ndtr((distance - inside) / max(psf_px, SHARPEST_PX))
        rows.append(spread @ (weight / 2) @ (weight / 2))
    table = np.concatenate(rows).astype(np.float32)
    table.setflags(write=False)
    return EdgeSpread(sigma, table)
