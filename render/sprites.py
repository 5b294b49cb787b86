"""Prefiltered images of marker cards, exact for the Gaussian that stands for lens and pixel.

A card is a grid of flat cells, so its image under a Gaussian of standard deviation sigma separates:

    F(y, x) = Σ_r Σ_c E_r(y) L_rc E_c(x),   E_c(x) = Φ((x - e_c) / σ) - Φ((x - e_{c+1}) / σ),

with L the cells' grey levels, e their edges and Φ the normal distribution. No supersampling is
involved. Sampled finely, F is resampled into the camera's image by one warp per marker.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from skyherd.geometry import Array
from skyherd.markers import QUIET_ZONE_CELLS, cells_per_side, marker_cells

OVERSAMPLING = 6
"""Sprite samples per image pixel: bilinear resampling then errs by less than half a grey level."""

SIZE_STEP = 1.003
"""Sprites are kept for marker sides in this geometric progression: blur is right to 0.15 %."""

MARGIN_SIGMAS = 4.0


@dataclass(frozen=True)
class Sprite:
    """Premultiplied card and coverage, (S, S, 2) float32, and its map from marker coordinates.

    `samples_per_side` sprite samples make one marker side; the marker's centre is the sprite's.
    """

    card_and_cover: npt.NDArray[np.float32]
    samples_per_side: float

    def sprite_from_marker(self) -> Array:
        """Affine map (3, 3) from marker coordinates (forward, left, in sides) to sprite samples."""
        center = (self.card_and_cover.shape[0] - 1) / 2
        k = self.samples_per_side
        return np.array([[0.0, -k, center], [-k, 0.0, center], [0.0, 0.0, 1.0]])


def size_bucket(side_px: float) -> int:
    """Index of the sprite size nearest to `side_px`."""
    return round(float(np.log(side_px) / np.log(SIZE_STEP)))


@lru_cache(maxsize=512)
def _gather(n_cells: int, bucket: int, sigma_px: float) -> npt.NDArray[np.float32]:
    """E (samples, cells): how much of each cell, quiet zone included, the Gaussian gathers at each sample."""
    side_px = SIZE_STEP**bucket
    lines = np.concatenate([[-QUIET_ZONE_CELLS], np.arange(n_cells + 1), [n_cells + QUIET_ZONE_CELLS]])
    edges = side_px * (lines / n_cells - 0.5)
    half = int(np.ceil((edges[-1] + MARGIN_SIGMAS * sigma_px) * OVERSAMPLING))
    x = np.arange(-half, half + 1) / OVERSAMPLING
    steps = ndtr((x[:, None] - edges[None, :]) / sigma_px)
    return (steps[:, :-1] - steps[:, 1:]).astype(np.float32)


@lru_cache(maxsize=256)
def marker_sprite(
    dictionary: str, marker_id: int, bucket: int, sigma_px: float, black: float, white: float
) -> Sprite:
    """Sprite of one marker for image sides near `SIZE_STEP ** bucket` and a blur of `sigma_px`."""
    cells = np.where(marker_cells(dictionary, marker_id), white, black).astype(np.float32)
    gather = _gather(cells_per_side(dictionary), bucket, sigma_px)
    cover = gather.sum(axis=1)
    # OpenCV's product, not NumPy's: BLAS threads on so small a product cost more than it does.
    rows = gather @ np.pad(cells, 1, constant_values=white)
    card = cv2.gemm(rows, gather, 1.0, np.empty(0), 0.0, flags=cv2.GEMM_2_T)
    sprite = np.asarray(cv2.merge([card, np.outer(cover, cover)]), dtype=np.float32)
    sprite.setflags(write=False)
    return Sprite(sprite, SIZE_STEP**bucket * OVERSAMPLING)
