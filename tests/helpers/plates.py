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
    """Return the shares (height, width) of pixels that a marker covers."""
    offsets = (np.arange(POINTS) + 0.5) / POINTS - 0.5
    corners = corners_px(matrix[None])[0]
    (left, top), (right, bottom) = np.floor(corners.min(axis=0)), np.ceil(corners.max(axis=0)) + 1
    u = (np.arange(left, right)[:, None] + offsets).ravel()
    v = (np.arange(top, bottom)[:, None] + offsets).ravel()
    x, y, w = np.einsum(
        "ij,jvu->ivu", np.linalg.inv(matrix), np.stack([*np.meshgrid(u, v), np.ones((v.size, u.size))])
    )
    inside = (np.abs(x / w) < 0.5) & (np.abs(y / w) < 0.5)
    shares = np.zeros(shape)
    whole = inside.reshape(v.size // POINTS, POINTS, u.size // POINTS, POINTS).mean(axis=(1, 3))
    shares[int(top) : int(bottom), int(left) : int(right)] = whole
    return shares


def corners_px(matrices: Array) -> Array:
    """Return the corners (N, 4, 2), px, of markers."""
    points = np.column_stack([to_points(SQUARE_CORNERS[None])[0], np.ones(4)]) @ matrices.transpose(0, 2, 1)
    return np.asarray(points[..., :2] / points[..., 2:])


def rough(rng: np.random.Generator, shape: tuple[int, int], level: float, std: float) -> Array:
    """Return ground (height, width) like short grass, of a mean level and a standard deviation."""
    blades = cv2.GaussianBlur(rng.normal(0, 1, shape), (0, 0), 0.8)
    return np.asarray(level + std * blades / blades.std())
