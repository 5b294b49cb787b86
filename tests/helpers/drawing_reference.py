"""Flat shapes laid over an image, row by row in double precision with NumPy: slow and simple.

The formulas are those of `render/native/`.
"""

import numpy as np

from skyherd.geometry import inverse
from skyherd.render.edge import BOXY, DIRECTIONS, FELT, PER_SIGMA, REACH, SAMPLES, SLANTED, SQUARE
from skyherd.render.paint import RING

GAUSS = (0.5 - 12**-0.5, 0.5 + 12**-0.5)
"""Nodes of Gauss's rule of two points, as shares of ρ."""


def _unit(vector):
    return vector / np.linalg.norm(vector)


def _table_start(normal):
    """Return the first index of the table for the direction nearest to a normal, at distance zero."""
    alpha = np.arctan2(normal[1], normal[0])
    direction = np.rint((1 - np.cos(4 * alpha)) / 2 * (DIRECTIONS - 1))
    return direction * SAMPLES + SAMPLES // 2


def _spread(spread, start, distance):
    places = np.floor(np.clip(distance, -REACH, REACH) * PER_SIGMA + start + 0.5)
    return spread.table[places.astype(int)].astype(float)


def _inside(outline, margin_px, u, v):
    """Return the pixels of a row within a margin of a convex outline."""
    (u_0, v_0), (u_1, v_1) = outline.T, np.roll(outline, -1, axis=0).T
    area = (u_0 * v_1 - v_0 * u_1).sum()
    inside = np.ones(u.shape, dtype=bool)
    for corner, after in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        normal = _unit(after - corner)[::-1] * [1, -1] * np.sign(area)
        inside &= (u - corner[0]) * normal[0] + (v - corner[1]) * normal[1] <= margin_px
    return inside


def _rows(images, corners, spread):
    """Yield number, row, columns and pixel geometry of each shape and image row.

    The geometry is places (2, P) in the shape, sharpness (2, P), cosines (P,), and the unit normals (2, 2) of
    x and y at the first pixel.
    """
    (width, height), lens = images.camera.size_px, images.lens()
    margin = REACH * spread.sigma_px
    outlines = images.project(corners)
    if images.bent:
        middles = images.project((corners + np.roll(corners, -1, axis=0)) / 2)
        chords = (outlines + np.roll(outlines, -1, axis=1)) / 2
        margin += 1.5 * np.abs(middles - chords).max()
    back = inverse(images.matrices)
    for number, outline in enumerate(outlines):
        for v in range(height):
            u = np.flatnonzero(_inside(outline, margin, np.arange(width), v))
            if not u.size:
                continue
            m = images._at(back, np.array([number]), np.array([float(v)]))[0]
            fields = np.zeros((6, u.size)) if lens is None else lens.fields[:, v * width + u].astype(float)
            slope = np.eye(2)[..., None] if lens is None else fields[2:].reshape(2, 2, -1)
            x, y, w = m @ np.stack([u + fields[0], v + fields[1], np.ones(u.size)])
            at = np.stack([x, y]) / w
            straight = m[:2, :2, None] - at[:, None] * m[None, 2, :2, None]
            gradients = np.einsum("ijp,jkp->ikp", straight, np.broadcast_to(slope, (2, 2, u.size)))
            lengths = np.linalg.norm(gradients, axis=1)
            cosines = (gradients[0] * gradients[1]).sum(axis=0) / lengths.prod(axis=0)
            first = m @ [u[0], v, 1]
            normals = m[:2, :2] - (first[:2] / first[2])[:, None] * m[2, :2]
            normals = np.stack([_unit(normal) for normal in normals])
            yield number, v, u, at, w / (spread.sigma_px * lengths), cosines, normals


def painted_lattices(canvas, images, levels, spread):
    """Return the canvas (height, width) with grids of grey `levels` (N, m, m) over it, as floats."""
    m = levels.shape[1]
    seen = canvas.astype(float)
    corners = np.array([[0.0, 0.0], [m, 0.0], [m, m], [0.0, m]])
    for number, v, u, at, sharpness, cosines, normals in _rows(images, corners, spread):
        grid = np.pad(levels[number].astype(float), 1)
        distance = (at[..., None] - np.arange(m + 1)) * sharpness[..., None]
        starts = [_table_start(normal) for normal in normals]
        gathered = np.stack([_spread(spread, s, d) for s, d in zip(starts, distance, strict=True)])
        felt = np.abs(distance) <= FELT
        gathered = np.where(felt, gathered, distance > 0)
        steps = np.diff(np.diff(grid, axis=0), axis=1)
        of_one = np.zeros(m + 1)
        of_one[[0, -1]] = 1, -1
        light = np.einsum("pj,jk,pk->p", gathered[1], steps, gathered[0])
        covered = (gathered[1] @ of_one) * (gathered[0] @ of_one)
        corner = (np.abs(cosines) > SQUARE) | (spread.kurtosis < -BOXY)
        a, b = normals
        even, odd_x, odd_y = (
            spread.kurtosis / of * k.sum() for k, of in ((a**2 * b**2, 4), (a**3 * b, 6), (a * b**3, 6))
        )
        x, y = distance[0][:, None, :], distance[1][:, :, None]
        density = np.zeros((u.size, m + 1, m + 1))
        for p in np.flatnonzero(corner):
            shares = GAUSS if abs(cosines[p]) > SLANTED else (0.5,)
            for r in (share * cosines[p] for share in shares):
                power = (x[p] ** 2 + y[p] ** 2 - 2 * r * x[p] * y[p]) / (-2 * (1 - r * r))
                density[p] += np.exp(power) / (2 * np.pi * np.sqrt(1 - r * r)) / len(shares)
        more = density * (cosines[:, None, None] + even * x * y + odd_x * (x * x - 1) + odd_y * (y * y - 1))
        more *= felt[1][:, :, None] & felt[0][:, None, :]
        light += np.einsum("pjk,jk->p", more, steps)
        covered += np.einsum("pjk,j,k->p", more, of_one, of_one)
        seen[v, u] = _kept(canvas, (1 - covered) * seen[v, u] + light)
    return seen


def sampled_ground(samples, size_px, frame, matrices):
    """Return the image (height, width) of a periodic texture `samples` (n, n), sampled bilinearly, as floats.

    `matrices` (Q, 3, 3) map undistorted pixels to samples, at one instant or at the times -1, 0 and 1.
    """
    width, height = size_px
    fields = np.zeros((2, height, width)) if frame.lens is None else frame.lens[:2].astype(float)
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    at = np.stack([u, v]) + fields.reshape(2, height, width)
    t = frame.row_times
    weights = (
        np.stack([t * (t - 1) / 2, 1 - t**2, t * (t + 1) / 2]) if len(matrices) == 3 else [np.ones(height)]
    )
    rows = np.einsum("qv,qij->vij", weights, matrices)
    x, y, w = np.einsum("vij,jvu->ivu", rows, np.concatenate([at, np.ones((1, height, width))]))
    x, y = x / w, y / w
    left, upper, n = np.floor(x).astype(int), np.floor(y).astype(int), len(samples)
    right, lower = x - left, y - upper
    corner = [[samples[(upper + j) % n, (left + i) % n].astype(float) for i in (0, 1)] for j in (0, 1)]
    above, below = ((1 - right) * pair[0] + right * pair[1] for pair in corner)
    return (1 - lower) * above + lower * below


def painted_discs(canvas, images, levels, spread):
    """Return the canvas (height, width) with discs of grey `levels` (N,) over it, as floats."""
    seen = canvas.astype(float)
    for number, v, u, at, sharpness, cosines, normals in _rows(images, RING, spread):
        radius = np.hypot(*at)
        across = at / sharpness
        square = (across**2).sum(axis=0) + 2 * cosines * across.prod(axis=0)
        sigma = np.sqrt(square) / radius
        covered = _spread(spread, _table_start(normals[0]), (1 - radius) / sigma - sigma / 2)
        seen[v, u] = _kept(canvas, (1 - covered) * seen[v, u] + levels[number] * covered)
    return seen


def _kept(canvas, values):
    return np.clip(np.rint(values), 0, 255) if canvas.dtype == np.uint8 else values
