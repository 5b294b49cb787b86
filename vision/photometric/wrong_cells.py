"""What one cell of the wrong colour would leave of a fit, which is what residuals are compared with.

Along each axis it leaves `E(x) = Φ((x + 1/2) / σ) - Φ((x - 1/2) / σ)` of the contrast, with x and the blur σ
in cells: over the cell itself `(∫ E)²` on average, and over the image the squares `(∫ E²)²` for each pixel of
the cell.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from skyherd.geometry import Array
from skyherd.vision.photometric.fitting.fit_result import FitResults

SAMPLES_PER_CELL, SPAN_CELLS = 8, 5
"""Sample points of a cell in the integrals of E, and number of cells that they cover: two cells on either
side, which is enough up to a blur of `skyherd.vision.photometric.verify.MAX_BLUR_CELLS`."""

MIN_DIVISOR_CONTRAST = 1e-3
"""Smallest contrast, grey levels, that residuals are compared with; a fit with less is refused anyway."""


@dataclass(frozen=True)
class WrongCellResiduals:
    """What one cell of the wrong colour would leave of N fits, grey levels.

    Attributes:
        means: (N,) mean residual over that cell.
        pixels: (N,) root mean square of the residuals of all pixels.
        cells_px: (N,) side of a cell, px.
    """

    means: Array
    pixels: Array
    cells_px: Array

    @classmethod
    def of(cls, fits: FitResults) -> "WrongCellResiduals":
        """Return the residuals for fits of N markers, at the blur that each fit found."""
        cells_px = fits.homographies.sides_px() / fits.cell_means.shape[1]
        log_sigmas = np.log(fits.blurs_cells) + np.minimum(np.maximum(fits.log_blurs, -1.0), 1.0)
        own, square = (np.interp(log_sigmas, _LOG_SIGMAS, table) for table in _integral_tables())
        contrast = np.maximum(fits.contrasts, MIN_DIVISOR_CONTRAST)
        return cls(
            means=contrast * own**2,
            pixels=contrast * square * cells_px / np.sqrt(np.maximum(fits.pixels, 1.0)),
            cells_px=cells_px,
        )


_LOG_SIGMAS: Array = np.linspace(np.log(0.01), np.log(10.0), 400)
"""Logarithms of the tabulated blurs, standard deviations in cells; linear interpolation is good to 1e-4."""


@lru_cache(maxsize=1)
def _integral_tables() -> tuple[Array, Array]:
    """`∫ E` over the wrong cell itself and `∫ E²` over all, each (400,), at the tabulated blurs."""
    x = (np.arange(SPAN_CELLS * SAMPLES_PER_CELL) + 0.5) / SAMPLES_PER_CELL - SPAN_CELLS / 2
    sigma = np.exp(_LOG_SIGMAS)[:, None]
    seen = ndtr((x + 0.5) / sigma) - ndtr((x - 0.5) / sigma)
    own = seen[:, np.abs(x) < 1 / 2].mean(axis=1)
    return own, (seen**2).sum(axis=1) / SAMPLES_PER_CELL
