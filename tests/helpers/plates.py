"""Markers cut out along their black border, on plates and rough ground."""

from collections.abc import Callable

import cv2
import numpy as np

from skyherd.geometry import SQUARE_CORNERS, Array, to_points

WHITE = 230.0
"""White level of the cards that `draw_markers` draws, grey levels."""

POINTS = 16
"""Points of a pixel along each axis. Edges are right to 1/32 px."""


def without_cards(matrices: Array, ground: float | Array) -> Callable[[Array], None]:
    """Return the `paint` of `draw_markers` that replaces the cards of markers, and all around, by ground.

    Args:
        matrices: (N, 3, 3) from a marker's plane (right, down, in sides) to pixels.
        ground: its grey level, or those of all pixels (height, width).
    """

    def paint(image: Array) -> None:
        shares = np.zeros(image.shape)
        for matrix in matrices:
            shares = np.maximum(shares, covered(matrix, image.shape))
        level = np.broadcast_to(ground, image.shape)
        image[...] = np.where(shares > 0, image + (1 - shares) * (level - WHITE), level)

    return paint


def covered(matrix: Array, shape: tuple[int, ...]) -> Array:
    """Return the shares (height, width) of pixels that a marker covers.

    A marker is convex, so that only pixels need points whose corners lie on different sides of an edge.
    """
    to_plane = np.linalg.inv(matrix)
    corners = corners_px(matrix[None])[0]
    left, top = np.floor(corners.min(axis=0)).astype(int)
    right, bottom = np.ceil(corners.max(axis=0)).astype(int) + 1

    def sides(u: Array, v: Array) -> tuple[Array, Array]:
        """Return on which side of the marker points lie along either axis: -1, 0 within it, or 1."""
        x, y, w = (row[0] * u + row[1] * v + row[2] for row in to_plane)
        return np.sign(x / w) * (np.abs(x / w) >= 0.5), np.sign(y / w) * (np.abs(y / w) >= 0.5)

    inside = np.ones((bottom - top, right - left), dtype=bool)
    outside = ~inside
    for side in sides(np.arange(left, right + 1) - 0.5, np.arange(top, bottom + 1)[:, None] - 0.5):
        four = np.stack([side[:-1, :-1], side[1:, :-1], side[:-1, 1:], side[1:, 1:]])
        inside &= (four == 0).all(axis=0)
        outside |= (four == 1).all(axis=0) | (four == -1).all(axis=0)
    found = inside.astype(float)
    rows, columns = np.nonzero(~inside & ~outside)
    offsets = (np.arange(POINTS) + 0.5) / POINTS - 0.5
    points = sides((left + columns)[:, None, None] + offsets, (top + rows)[:, None, None] + offsets[:, None])
    found[rows, columns] = ((points[0] == 0) & (points[1] == 0)).mean(axis=(1, 2))
    shares = np.zeros(shape)
    shares[top:bottom, left:right] = found
    return shares


def corners_px(matrices: Array) -> Array:
    """Return the corners (N, 4, 2), px, of markers."""
    points = np.column_stack([to_points(SQUARE_CORNERS[None])[0], np.ones(4)]) @ matrices.transpose(0, 2, 1)
    return np.asarray(points[..., :2] / points[..., 2:])


def rough(rng: np.random.Generator, shape: tuple[int, int], level: float, std: float) -> Array:
    """Return ground (height, width) like short grass, of a mean level and a standard deviation."""
    blades = cv2.GaussianBlur(rng.normal(0, 1, shape), (0, 0), 0.8)
    return np.asarray(level + std * blades / blades.std())
