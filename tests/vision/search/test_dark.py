"""Dark regions without an outline: which are taken as squares, and how those at the border are completed."""

import cv2
import numpy as np
import pytest

from skyherd.vision.search.dark import cut_squares, dark_outlines, square_patches


def test_patches_are_squares_around_dark_regions() -> None:
    """A square without a corner, of a marker's size, and an oblong, which is none."""
    image = np.full((200, 300), 200, np.uint8)
    image[50:110, 60:120], image[60:90, 180:270] = 30, 30
    cv2.circle(image, (60, 50), 20, 200, -1)
    patches = square_patches(dark_outlines(image))
    np.testing.assert_allclose(np.unique(patches.mean(axis=1).round(), axis=0), [[90, 80]], atol=1.5)


@pytest.mark.parametrize("left", [0, 130])
def test_square_cut_at_either_border_is_completed(left) -> None:
    """60 px high, of which 40 px are in the image: one square on the whole side is right."""
    image = np.full((200, 170), 200, np.uint8)
    image[70:130, left : left + 40] = 30
    squares = cut_squares(dark_outlines(image), image, 6)
    center = (9.5, 99.5) if left == 0 else (159.5, 99.5)
    assert np.linalg.norm(squares.mean(axis=1) - center, axis=1).min() < 2


def test_square_inside_the_image_is_not_completed() -> None:
    image = np.full((200, 200), 200, np.uint8)
    image[70:130, 70:130] = 30
    assert cut_squares(dark_outlines(image), image, 6).shape == (0, 4, 2)
