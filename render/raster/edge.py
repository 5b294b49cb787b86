"""How lens and pixel spread an edge: the law that every drawn edge obeys, as a table.

Light crosses a Gaussian of standard deviation psf and is gathered by a square pixel. Across a straight edge
whose normal makes an angle alpha with the image's axes, at a signed distance d from it, a pixel receives

    S(d) = ∫∫ Φ((d - a cos α - b sin α) / psf) da db   over the unit square,

Φ being the normal distribution. With total variance `σ² = psf² + 1/12` this is nearly Φ(d / σ); the rest, up
to 0.3 grey levels at a psf of 0.5 px, comes of the square not being a Gaussian.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from skyherd.geometry import Array
from skyherd.markers.blur_model import total_sigma_px

REACH = 4.0
"""Distances in σ beyond which an edge is not felt: 0.006 grey levels of 200 are left."""

SAMPLES = 4096
"""Entries of the table for each direction: nearest ones are right to 0.08 grey levels of 200."""

DIRECTIONS = 5
"""Tables between edges along an image axis and along a diagonal, even in cos 4α."""

SHARPEST_PX = 0.05
"""Narrower lenses are drawn as this wide, which the pixel's own width hides."""


@dataclass(frozen=True)
class EdgeSpread:
    """S for one lens.

    Attributes:
        sigma_px: σ of lens and pixel together.
        table: (DIRECTIONS * SAMPLES,) float32, S at distances from -REACH to REACH σ.
    """

    sigma_px: float
    table: npt.NDArray[np.float32]

    @property
    def kurtosis(self) -> float:
        """Fourth cumulant of a pixel's width, -1/120 px⁴, over σ⁴."""
        return -1.0 / 120.0 / self.sigma_px**4

    def start(self, normals: Array) -> Array:
        """Where in the table distance zero lies for edges with normals (..., 2) in the image.

        Half an entry more, so that cutting off decimals rounds to the nearest entry.
        """
        u, v = normals[..., 0] ** 2, normals[..., 1] ** 2
        straight = ((u - v) ** 2 - 4 * u * v) / np.maximum((u + v) ** 2, 1e-300)  # cos 4α
        direction = np.rint((1 - straight) / 2 * (DIRECTIONS - 1))
        return np.asarray(direction * SAMPLES + SAMPLES // 2 + 0.5)


PER_SIGMA = (SAMPLES / 2 - 1) / REACH
"""Table entries to one σ."""


@lru_cache(maxsize=64)
def edge_spread(psf_px: float) -> EdgeSpread:
    """The edge spread of a lens of `psf_px`, by Gauss-Legendre quadrature over the pixel."""
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
