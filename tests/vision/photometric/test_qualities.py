"""Covariances of markers that no photometric fit measures."""

import cv2
import numpy as np
import pytest

from skyherd.messages import Quality
from skyherd.vision import PhotometricDetector

DICTIONARY = "4X4_50"
IDS = [3, 7, 11, 20]
PLACES = np.array([50 + 50j, 130 + 55j, 60 + 130j, 140 + 135j])


def faint(image, rng):
    """Return the image with 1/26 of its contrast, about six grey levels, and noise of one."""
    return np.clip(np.rint(120 + (image - 120.0) / 26 + rng.normal(0, 1, image.shape)), 0, 255)


def blotchy(image, rng):
    """Return the image under stains of 14 grey levels about 2.5 px wide, and 5 % salt."""
    stains = cv2.GaussianBlur(rng.normal(0, 1, image.shape), (0, 0), 2.5)
    stained = image + 14 * stains / stains.std() + rng.normal(0, 1, image.shape)
    stained[rng.random(image.shape) < 0.05] = 255
    return np.clip(stained, 0, 255)


@pytest.mark.parametrize(
    ("change", "images", "quality"), [(faint, 80, Quality.CORNERS), (blotchy, 45, Quality.ROBUST)]
)
def test_covariances_without_a_fit_match_the_errors(place_markers, draw_markers, change, images, quality):
    """NEES of the centres between 0.5 and 2 over 30 markers or more, whose own deviation is below 0.2."""
    nees = []
    for seed in range(images):
        rng = np.random.default_rng([7, seed])
        centers = PLACES + rng.uniform(-3, 3, 4) + 1j * rng.uniform(-3, 3, 4)
        image = draw_markers(place_markers(centers, rng.uniform(-3, 3, 4), 40.0), IDS, (190, 190), rng)
        seen = PhotometricDetector(DICTIONARY, following=False).detect(change(image, rng).astype(np.uint8))
        off_px = seen.centers_px - centers[np.searchsorted(IDS, seen.ids), None].view(float)
        squares = np.einsum("ni,nij,nj->n", off_px, np.linalg.inv(seen.covariances[:, :2, :2]), off_px) / 2
        nees += squares[seen.qualities == quality].tolist()
    assert len(nees) >= 30
    assert 0.5 < np.mean(nees) < 2
