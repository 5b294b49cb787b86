"""Downsampling by block means."""

import numpy as np
import pytest

from skyherd.vision.grey import block_means


@pytest.mark.parametrize("side", [2, 3, 4])
def test_pixel_is_the_mean_of_its_block(side: int) -> None:
    """Equal up to rounding. With 31 x 22 pixels, every side leaves incomplete rows or columns."""
    image = np.random.default_rng(side).integers(0, 256, (31, 22), dtype=np.uint8)
    height, width = 31 // side, 22 // side
    whole = image[: height * side, : width * side].astype(float)
    means = whole.reshape(height, side, width, side).mean(axis=(1, 3))
    small = block_means(image, side)
    assert small.shape == (height, width) and small.dtype == np.uint8
    assert np.abs(small - means).max() <= 0.5


def test_image_smaller_than_a_block_becomes_empty() -> None:
    assert block_means(np.zeros((3, 9), np.uint8), 4).shape == (0, 0)
