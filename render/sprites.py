"""Prefiltered images of marker cards, exact for the Gaussian that stands for lens and pixel.

A card under a Gaussian is two small matrix products (`skyherd.optics`); no supersampling is involved. Sampled
finely, it is resampled into the camera's image by one warp per marker.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array
from skyherd.markers import cells_per_side, marker_cells
from skyherd.optics import cell_edges, gather

OVERSAMPLING = 6
"""Sprite samples per image pixel: bilinear resampling then errs by less than half a grey level."""

SIZE_STEP = 1.003
"""Sprites are kept for marker sides in this geometric progression: blur is right to 0.15 %."""

LARGE_SIDE_PX = 60.0
"""Larger markers are sampled less finely, so that no sprite takes more memory than one of this size."""

MARGIN_SIGMAS = 4.0


def samples_per_px(bucket: int) -> float:
    """Sprite samples per image pixel for a size bucket."""
    return OVERSAMPLING * min(1.0, LARGE_SIDE_PX / SIZE_STEP**bucket)


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
    """E (samples, cells) for a size bucket: how much of each cell the blur gathers at each sample."""
    edges = cell_edges(n_cells, SIZE_STEP**bucket)
    rate = samples_per_px(bucket)
    half = int(np.ceil((edges[-1] + MARGIN_SIGMAS * sigma_px) * rate))
    return gather(np.arange(-half, half + 1) / rate, edges, sigma_px).astype(np.float32)


@lru_cache(maxsize=256)
def marker_sprite(
    dictionary: str, marker_id: int, bucket: int, sigma_px: float, black: float, white: float
) -> Sprite:
    """Sprite of one marker for image sides near `SIZE_STEP ** bucket` and a blur of `sigma_px`."""
    cells = np.where(marker_cells(dictionary, marker_id), white, black).astype(np.float32)
    gathered = _gather(cells_per_side(dictionary), bucket, sigma_px)
    cover = gathered.sum(axis=1)
    # OpenCV's product, not NumPy's: BLAS threads on so small a product cost more than it does.
    rows = gathered @ np.pad(cells, 1, constant_values=white)
    card = cv2.gemm(rows, gathered, 1.0, np.empty(0), 0.0, flags=cv2.GEMM_2_T)
    sprite = np.asarray(cv2.merge([card, np.outer(cover, cover)]), dtype=np.float32)
    sprite.setflags(write=False)
    return Sprite(sprite, SIZE_STEP**bucket * samples_per_px(bucket))
