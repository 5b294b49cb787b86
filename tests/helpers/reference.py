"""An exact image of flat markers under any homography, that shares nothing with `skyherd.render`.

A pixel's value is the scene's light under the lens's Gaussian g of standard deviation s, gathered by its
square. Both are products of a function of u and one of v, so that the pixel's weight is K(u) K(v) with

    K(t) = Φ((t + 1/2) / s) - Φ((t - 1/2) / s).

By Green's theorem the share of a polygon P that the pixel at (c, r) gathers is an integral along its edges,

    ∫∫_P K(u - c) K(v - r) du dv = ∮ Q(u - c) K(v - r) dv,    Q' = K,

and edges shared by two cells of one grey level cancel. The integrals along the edges are Gauss-Legendre sums
over short pieces; all else is closed form, so that blur, tilt and size cost no accuracy.
"""

from collections.abc import Callable

import cv2
import numpy as np
from scipy.special import ndtr

BLACK, WHITE = 30.0, 230.0
NODES, PIECE_PX = 6, 1.0
CHORDS = 8


def from_pixel_borders(at: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return signed distances (N, P + 1) of points (N,) from the borders of P adjacent pixels."""
    assert (np.diff(pixels) == 1).all()
    return at[:, None] - np.append(pixels - 0.5, pixels[-1] + 0.5)[None, :]


def pixel_weight(at: np.ndarray, pixels: np.ndarray, psf_px: float) -> np.ndarray:
    """Return K(t) at t = at - pixels, (N, P)."""
    return -np.diff(ndtr(from_pixel_borders(at, pixels) / psf_px), axis=1)


def pixel_gathered(at: np.ndarray, pixels: np.ndarray, psf_px: float) -> np.ndarray:
    """Return Q(t), the integral of K from -inf to t, at t = at - pixels, (N, P).

    It is the difference of x Φ(x/s) + s φ(x/s) between the pixel's sides.
    """
    x = from_pixel_borders(at, pixels)
    z = x / psf_px
    return -np.diff(x * ndtr(z) + psf_px / np.sqrt(2 * np.pi) * np.exp(-z * z / 2), axis=1)


def polygon_edges_light(
    starts_px: np.ndarray,
    ends_px: np.ndarray,
    steps: np.ndarray,
    psf_px: float,
    columns: np.ndarray,
    rows: np.ndarray,
    piece_px: float = PIECE_PX,
    nodes: int = NODES,
) -> np.ndarray:
    """Return the light (rows, columns) of regions bounded by edges (M, 2) to (M, 2).

    `steps` (M,) is the excess of light on the side of smaller u. The edge runs towards larger v, which points
    down, and this side is on its right.
    """
    pieces = np.maximum(np.ceil(np.abs(ends_px - starts_px).max(axis=1) / piece_px), 1).astype(int)
    edge = np.repeat(np.arange(len(pieces)), pieces)
    number = np.arange(edge.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    x, weight = np.polynomial.legendre.leggauss(nodes)
    share = (number[:, None] + (x[None, :] + 1) / 2) / pieces[edge][:, None]
    along = ends_px - starts_px
    points = starts_px[edge][:, None] + share[..., None] * along[edge][:, None]
    measure = (steps * along[:, 1] / pieces)[edge][:, None] * (weight / 2)[None, :]
    u, v, measure = points[..., 0].ravel(), points[..., 1].ravel(), measure.ravel()
    across = pixel_weight(v, rows, psf_px) * measure[:, None]
    return across.T @ pixel_gathered(u, columns, psf_px)


def lattice_edges(levels: np.ndarray, image_lattice: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return edges (starts, ends, steps) of cells (m, m) under a homography from (column, row) to px."""
    padded = np.pad(levels, 1)
    row, column = np.nonzero(np.diff(padded, axis=1)[1:-1])
    upright = np.stack([column, row], axis=-1), np.stack([column, row + 1], axis=-1)
    upright_step = -np.diff(padded, axis=1)[1:-1][row, column]
    row, column = np.nonzero(np.diff(padded, axis=0)[:, 1:-1])
    level = np.stack([column, row], axis=-1), np.stack([column + 1, row], axis=-1)
    level_step = np.diff(padded, axis=0)[:, 1:-1][row, column]
    starts, ends = (np.concatenate(pair).astype(float) for pair in zip(upright, level, strict=True))

    def to_image(points: np.ndarray) -> np.ndarray:
        mapped = points @ image_lattice[:, :2].T + image_lattice[:, 2]
        return mapped[:, :2] / mapped[:, 2:]

    # A homography that turns the plane over turns over which side of an edge is which.
    corners = to_image(np.array([[0, 0], [1, 0], [0, 1]], dtype=float))
    sense = np.sign(np.linalg.det(corners[1:] - corners[0]))
    return to_image(starts), to_image(ends), sense * np.concatenate([upright_step, level_step])


def bent(
    starts: np.ndarray, ends: np.ndarray, steps: np.ndarray, bend: Callable[[np.ndarray], np.ndarray] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the edges through a lens, in CHORDS straight pieces each, or unchanged."""
    if bend is None:
        return starts, ends, steps
    share = np.linspace(0, 1, CHORDS + 1)[None, :, None]
    points = starts[:, None] + share * (ends - starts)[:, None]
    points = bend(points.reshape(-1, 2)).reshape(points.shape)
    return points[:, :-1].reshape(-1, 2), points[:, 1:].reshape(-1, 2), np.repeat(steps, CHORDS)


def card_levels(dictionary: str, marker_id: int) -> np.ndarray:
    """Return grey levels (n + 2, n + 2) of a marker with its white card, as OpenCV draws it."""
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
    n = book.markerSize + 2
    drawn = cv2.aruco.generateImageMarker(book, marker_id, 10 * n)[5::10, 5::10]
    return np.pad(np.where(drawn > 127, WHITE, BLACK), 1, constant_values=WHITE)


def reference_light(
    dictionary: str,
    ids: np.ndarray,
    images_marker: np.ndarray,
    size_px: tuple[int, int],
    *,
    psf_px: float,
    ground: float | np.ndarray = 128.0,
    bend: Callable[[np.ndarray], np.ndarray] | None = None,
    piece_px: float = PIECE_PX,
    nodes: int = NODES,
) -> np.ndarray:
    """Return noise-free light (height, width) of markers flat on a uniform ground, or over a given image.

    `images_marker` (N, 3, 3) map marker coordinates (forward, left) in sides to pixels, `bend` takes those
    (M, 2) through a lens. Each marker is drawn over those before it.
    """
    width, height = size_px
    light = np.empty((height, width))
    light[:] = ground
    for marker_id, image_marker in zip(ids, images_marker, strict=True):
        levels = card_levels(dictionary, int(marker_id))
        m = len(levels)
        # Row 0 is the forward edge and column 0 the left one; the black square is cells 1 to m - 1.
        marker_lattice = np.array([[0, -1, m / 2], [-1, 0, m / 2], [0, 0, m - 2.0]])
        image_lattice = image_marker @ marker_lattice
        corners = np.array([[0, 0, 1], [m, 0, 1], [m, m, 1], [0, m, 1.0]]) @ image_lattice.T
        corners = corners[:, :2] / corners[:, 2:]
        corners = corners if bend is None else bend(corners)
        low = np.maximum(np.floor(corners.min(axis=0) - 7 * psf_px - 1), 0).astype(int)
        high = np.minimum(np.ceil(corners.max(axis=0) + 7 * psf_px + 2), size_px).astype(int)
        if (low >= high).any():
            continue
        columns, rows = np.arange(low[0], high[0]), np.arange(low[1], high[1])
        drawn, cover = (
            polygon_edges_light(
                *bent(*lattice_edges(grid, image_lattice), bend), psf_px, columns, rows, piece_px, nodes
            )
            for grid in (levels, np.ones_like(levels))
        )
        region = light[low[1] : high[1], low[0] : high[0]]
        region[...] = drawn + (1 - cover) * region
    return light
