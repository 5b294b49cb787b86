"""Downsampling by block means, and grey levels on grids within quadrilaterals."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from tests.helpers.native_builds import builds

from skyherd.errors import InputError
from skyherd.vision import grey
from skyherd.vision.grey import block_means, sample_squares
from skyherd.vision.native.library import declared, library


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


@pytest.mark.parametrize("side", [2, 3, 4, 8, 16])
def test_block_means_of_all_builds_equal_opencv(side: int) -> None:
    """Equal bytes, halves included: sums of low grey levels are often halves of a block's pixels."""
    rng = np.random.default_rng([7, side])
    for image in (
        rng.integers(0, 256, (95, 131), dtype=np.uint8),
        rng.integers(0, 3, (64, 48), dtype=np.uint8),
    ):
        height, width = (length // side for length in image.shape)
        whole = image[: height * side, : width * side]
        expected = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
        for build in builds("vision", declared).values():
            np.testing.assert_array_equal(build.block_means(image, side), expected)


@pytest.mark.parametrize("side", [1, 6, 300])
def test_blocks_that_do_not_fit_are_rejected(side: int) -> None:
    with pytest.raises(InputError, match="an invalid size"):
        library().block_means(np.zeros((5, 600), np.uint8), side)


def some_quads(count: int, rng: np.random.Generator) -> np.ndarray:
    """Tilted squares of 5 to 40 px, some of them partly beyond an image of 60 x 50 px."""
    turns = rng.uniform(0, 2 * np.pi, (count, 1)) + np.arange(4) * np.pi / 2
    circle = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    middles, sides = rng.uniform(0, 60, (count, 1, 2)), rng.uniform(5, 40, (count, 1, 1))
    return np.asarray(middles + circle * sides / np.sqrt(2) + rng.normal(0, 0.05, circle.shape) * sides)


@pytest.mark.parametrize("fine", [1, 3])
def test_grids_are_read_as_by_opencv_and_scipy(fine: int) -> None:
    """Homographies by OpenCV, bilinear interpolation by SciPy; the grid reaches beyond the squares."""
    rng = np.random.default_rng(5)
    image, quads = rng.integers(0, 256, (50, 60), dtype=np.uint8), some_quads(40, rng)
    at = np.linspace(-0.2, 1.2, 7 * fine)
    levels = sample_squares(image, quads, at, fine)
    grid = np.stack(np.meshgrid(at, at), axis=-1).reshape(1, -1, 2)
    unit = np.float32([[0, 0], [1, 0], [1, 1], [0, 1]])
    for quad, level in zip(quads, levels, strict=True):
        matrix = cv2.getPerspectiveTransform(unit, quad.astype(np.float32))
        u, v = cv2.perspectiveTransform(grid, matrix)[0].T
        read = map_coordinates(image.astype(float), [v, u], order=1, mode="nearest")
        expected = read.reshape(7, fine, 7, fine).mean(axis=(1, 3))
        np.testing.assert_allclose(level, expected, atol=0.02)


def test_degenerate_squares_read_some_pixel_and_builds_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(6)
    image = rng.integers(10, 20, (9, 12), dtype=np.uint8)
    quads = np.concatenate([some_quads(5, rng), np.zeros((1, 4, 2)), np.full((1, 4, 2), np.nan)])
    quads[0, 1], quads[1] = quads[0, 0], 1e300
    read = []
    for build in builds("vision", declared).values():
        monkeypatch.setattr(grey, "library", lambda build=build: build)
        levels = sample_squares(image, quads, np.linspace(0, 1, 6), 2)
        assert (levels >= 10).all() and (levels < 20).all()
        read.append(levels.tobytes())
    assert all(one == read[0] for one in read)


def test_only_quadrilaterals_are_sampled() -> None:
    with pytest.raises(InputError, match="corners"):
        sample_squares(np.zeros((5, 5), np.uint8), np.zeros((2, 3, 2)), np.zeros(2))
    with pytest.raises(InputError, match="search"):
        sample_squares(np.zeros((5, 5), np.uint8), np.zeros((2, 4, 2)), np.zeros(0))
    with pytest.raises(InputError, match="an invalid size"):
        sample_squares(np.zeros((0, 5), np.uint8), np.zeros((2, 4, 2)), np.zeros(2))
