"""Grey levels of the cells of a quadrilateral that is taken for a marker, and of the margin around it."""

import cv2
import numpy as np

from skyherd.geometry import Array, BoolArray, to_complex
from skyherd.vision.grey import Image, sample_grey
from skyherd.vision.search.decode import square_to_quads

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


def sample_middles(image: Image, quads_px: Array, n: int) -> tuple[Array, BoolArray]:
    """Return the levels (N, n²) of the middles of n x n cells, and which of them lie in the image.

    The levels are those of `sample_cells` at the same places.

    Args:
        image: grey, (height, width).
        quads_px: (N, 4, 2) corners, in order around each.
        n: cells along a side.
    """
    corners = to_complex(quads_px)
    fine = (np.arange(FINE) + 0.5) / (FINE * PER_CELL) + (PER_CELL // 2) / PER_CELL
    at = (np.arange(n)[:, None] + fine).ravel() / n
    grey = sample_grey(image, square_to_quads(corners, at[None, :], at[:, None]))
    levels = grey.reshape(len(corners), n, FINE, n, FINE).mean(axis=(2, 4))
    middle = (np.arange(n) + 0.5) / n
    places = square_to_quads(corners, middle[None, :], middle[:, None])
    height, width = image.shape
    inside = (abs(places.real - (width - 1) / 2) < width / 2) & (
        abs(places.imag - (height - 1) / 2) < height / 2
    )
    return levels.reshape(len(corners), -1), inside.reshape(len(corners), -1)
