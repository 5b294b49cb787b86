"""Grey levels of the cells of a quadrilateral that is taken for a marker, and of the margin around it."""

import cv2
import numpy as np

from skyherd.geometry import Array
from skyherd.vision.grey import Image

PER_CELL = 3
"""Samples of a cell along each axis on which likeness is measured. Chosen odd, so that one lies in the
middle."""

FINE = 3
"""Finer samples along each axis that are averaged into one of the above. Chosen: fewer are noisier where a
cell has many pixels."""


def image_from_cells(corners_px: Array, n: int) -> Array:
    """Return the homography (3, 3) from cell coordinates, 0 to n to the right and down, to pixels."""
    square = np.array([[0, 0], [n, 0], [n, n], [0, n]], np.float32)
    return np.asarray(cv2.getPerspectiveTransform(square, corners_px.astype(np.float32)), dtype=float)


def cell_extents_px(image_cells: Array, n: int) -> Array:
    """Shorter and longer extent of a cell at the centre, px."""
    w = image_cells @ [n / 2, n / 2, 1.0]
    jacobian = (image_cells[:2, :2] - np.outer(w[:2] / w[2], image_cells[2, :2])) / w[2]
    return np.asarray(np.linalg.svd(jacobian, compute_uv=False)[::-1])


def sample_cells(image: Image, image_cells: Array, n: int) -> Array:
    """Return levels (S, S), S = (n + 2) PER_CELL, of cells and quiet zone; not a number off the image."""
    size = (n + 2) * PER_CELL
    fine = PER_CELL * FINE
    first = 0.5 / fine - 1
    to_cells = np.array([[1 / fine, 0, first], [0, 1 / fine, first], [0, 0, 1]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpPerspective(
        image,
        image_cells @ to_cells,
        (size * FINE, size * FINE),
        flags=flags,
        borderMode=cv2.BORDER_REPLICATE,
    )
    samples = np.asarray(warped, dtype=float).reshape(size, FINE, size, FINE).mean(axis=(1, 3))
    at = (np.arange(size) + 0.5) / PER_CELL - 1
    points = np.stack(np.meshgrid(at, at), axis=-1) @ image_cells[:, :2].T + image_cells[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):  # a quadrilateral may have its horizon inside
        u, v = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    inside = (u > -0.5) & (v > -0.5) & (u < image.shape[1] - 0.5) & (v < image.shape[0] - 0.5)
    return np.where(inside, samples, np.nan)
