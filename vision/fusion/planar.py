"""Fusion of the markers of a robot that lie in one plane parallel to the ground.

The places of the markers on the robot are known (`skyherd.markers.layout`). One homography G maps their plane
to the image. A first G is that of the marker nearest to the robot's reference point. It is then
corrected by a homography of the robot's plane near the identity,

    z ↦ z + d + (s + iφ) z + a z̄ - w (b · w),    w = z - z_0,

with the shift d, the size s, the turn φ, the anisotropy a and the perspective b, z_0 being the nearest
marker's centre. To first order, it moves marker i, at z_i with the direction ψ_i, by

    centre:     J_i (d + (s + iφ) z_i + a z̄_i - w_i (b · w_i))
    heading:    φ · Im(ā_i b_i) / |a_i|²,    a_i = J_i e^{iψ_i},  b_i = J_i i e^{iψ_i}
    log size:   s

J_i being the derivative of G at z_i. Headings and sizes do not change with a and b: the detector fits one
plane to all N markers of an image, so that its errors are in G and in all headings alike. Errors of the
plane have the variances `ANISOTROPY_SHARE / N` and `PERSPECTIVE_SHARE / N` of a heading's. Generalized least
squares over the markers, by their covariances, gives the eight unknowns with their covariance.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array, ComplexArray, IntArray, to_points, wrap_angle
from skyherd.markers.layout import MarkerLayout
from skyherd.messages import Detections, Quality
from skyherd.vision.fusion.robots import apply, derivatives, detections_of_robots, group_by_place

SIZE_SHARE, ANISOTROPY_SHARE, PERSPECTIVE_SHARE = 0.35, 0.9, 0.025
"""Variances of a marker's log size, and of the plane's anisotropy and perspective (1/side²) times the number
of markers, over the variance of a heading, rad². Measured on 25 rendered images each of 6 and 30 markers of
4X4_50, tilts up to 40°: 0.30 and 0.34, 0.80 and 0.96, 0.027 and 0.023."""

MAX_PLANE_SHARE = 0.5
"""Maximum share of a heading's variance that is taken as the plane's. Chosen: it keeps the heading's own
variance positive with few markers."""

UNKNOWNS = 8
"""Unknowns of a homography of the plane: d (2), φ, s, a (2) and b (2), in this order."""


@dataclass(frozen=True)
class _RobotImage:
    """Homography (3, 3) from the robot's plane, sides, to pixels, with the covariance (3, 3) of the pose."""

    homography: Array
    covariance: Array


def fuse_planar_markers(found: Detections, layout: MarkerLayout) -> Detections:
    """Return the robots in an image, from the detections of their markers; see `fuse_markers`.

    Args:
        found: the markers in an image.
        layout: the markers on the robots, which is flat.
    """
    rows = layout.rows_of(found.ids)
    others, on_robots = found[np.flatnonzero(rows < 0)], found[np.flatnonzero(rows >= 0)]
    rows = rows[rows >= 0]
    robots = layout.robot_ids[rows]
    places = np.array(
        [
            apply(_fit(layout.corners_sides[row], corners), np.zeros(1))[0]
            for row, corners in zip(rows, on_robots.corners_px, strict=True)
        ]
    )
    groups = group_by_place(robots, on_robots.ids, places, on_robots.sides_px)
    count = max(1, int((found.qualities == Quality.PHOTOMETRIC).sum()))
    plane = np.repeat([ANISOTROPY_SHARE, PERSPECTIVE_SHARE], 2) / count
    images = [_fuse(on_robots[members], layout, rows[members], plane) for members in groups]
    return detections_of_robots(
        on_robots,
        groups,
        np.array([robots[members[0]] for members in groups], dtype=np.int64),
        np.array([image.homography for image in images]),
        np.array([image.covariance for image in images]),
        others,
    )


def _fuse(seen: Detections, layout: MarkerLayout, rows: IntArray, plane: Array) -> _RobotImage:
    """Return the image of a robot's plane from its markers.

    Args:
        seen: detections (K,) of the robot's markers.
        layout: the markers on the robots.
        rows: (K,) rows of these markers in the layout.
        plane: (4,) variances of a and b, as a share of each marker's heading variance.
    """
    known = seen.covariances.any(axis=(1, 2))
    if not known.any():
        homography = _fit(layout.corners_sides[rows].ravel(), seen.corners_px.reshape(-1, 2))
        return _RobotImage(homography, np.zeros((3, 3)))
    seen, rows = seen[known], rows[known]
    nearest = int(np.argmin(np.abs(layout.offsets_sides[rows])))
    start = _fit(layout.corners_sides[rows[nearest]], seen.corners_px[nearest])
    middle = layout.offsets_sides[rows[nearest]]
    state, errors = _correction(start, middle, seen, layout, rows, plane)
    homography = start @ _homography_of(state, middle)
    origin = np.zeros(1, dtype=complex)
    by_state = np.zeros((3, UNKNOWNS))
    by_state[:2] = derivatives(homography, origin)[0] @ _moves(origin, middle)[0]
    # The direction of the image of 1 turns with φ, with a, and with the perspective about the middle.
    by_state[2, 2], by_state[2, 5] = 1.0, 1.0
    by_state[2, 6] = middle.imag
    by_state[2] *= _turns(homography, origin, np.zeros(1))[0]
    return _RobotImage(homography, by_state @ errors @ by_state.T)


def _correction(
    start: Array, middle: complex, seen: Detections, layout: MarkerLayout, rows: IntArray, plane: Array
) -> tuple[Array, Array]:
    """Return the unknowns (8,) by which a homography is corrected, and their covariance (8, 8)."""
    offsets, yaws_rad = layout.offsets_sides[rows], layout.yaws_rad[rows]
    slopes, turns = derivatives(start, offsets), _turns(start, offsets, yaws_rad)
    own = np.array(
        [
            derivatives(_fit(corners, points), offset[None])[0]
            for corners, points, offset in zip(
                layout.corners_sides[rows], seen.corners_px, offsets, strict=True
            )
        ]
    )
    residuals = np.zeros((len(rows), 4))
    residuals[:, :2] = seen.centers_px - to_points(apply(start, offsets))
    residuals[:, 2] = wrap_angle(seen.headings_rad - np.angle(_directions(slopes, np.exp(1j * yaws_rad))))
    residuals[:, 3] = np.log(np.abs(np.linalg.det(own) / np.linalg.det(slopes))) / 2
    design = np.zeros((len(rows), 4, UNKNOWNS))
    design[:, :2] = slopes @ _moves(offsets, middle)
    design[:, 2, 2], design[:, 3, 3] = turns, 1.0
    covariances = np.zeros((len(rows), 4, 4))
    covariances[:, :3, :3] = seen.covariances
    headings = covariances[:, 2, 2] / turns**2
    covariances[:, 3, 3] = SIZE_SHARE * headings
    covariances[:, 2, 2] *= 1 - min(float(plane[0]), MAX_PLANE_SHARE)
    weights = np.linalg.inv(covariances)
    information = np.einsum("kij,kil,klm->jm", design, weights, design)
    information[range(4, UNKNOWNS), range(4, UNKNOWNS)] += 1 / (plane * headings.mean())
    errors = np.linalg.inv(information)
    state: Array = errors @ np.einsum("kij,kil,kl->j", design, weights, residuals)
    return state, errors


def _moves(points: ComplexArray, middle: complex) -> Array:
    """Return the derivatives (K, 2, 8) of corrected plane points (K,) by the unknowns."""
    away = points - middle
    columns = [np.ones_like(points), np.full_like(points, 1j), 1j * points, points]
    columns += [points.conj(), 1j * points.conj(), -away * away.real, -away * away.imag]
    return np.stack([to_points(column) for column in columns], axis=-1)


def _homography_of(state: Array, middle: complex) -> Array:
    """Return the homography (3, 3) of the plane for the unknowns (8,)."""
    d_x, d_y, phi, s, a_x, a_y, b_x, b_y = state
    affine = np.array([[1 + s + a_x, a_y - phi, d_x], [a_y + phi, 1 + s - a_x, d_y], [0.0, 0.0, 1.0]])
    shift, back = np.eye(3), np.eye(3)
    shift[:2, 2], back[:2, 2] = (middle.real, middle.imag), (-middle.real, -middle.imag)
    perspective = np.eye(3)
    perspective[2, :2] = b_x, b_y
    return np.asarray(affine @ shift @ perspective @ back)


def _fit(points: ComplexArray, pixels: Array) -> Array:
    """Return the homography (3, 3) that maps plane points (K,) to pixels (K, 2), by least squares.

    The direct linear transformation in normalized coordinates (Hartley 1997), K at least 4.
    """
    plane = to_points(points)
    normal_plane, normal_image = _normalizer(plane), _normalizer(pixels)
    x, y = (plane @ normal_plane[:2, :2].T + normal_plane[:2, 2]).T
    u, v = (pixels @ normal_image[:2, :2].T + normal_image[:2, 2]).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    equations = np.concatenate(
        [
            np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=1),
            np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=1),
        ]
    )
    solution = np.linalg.svd(equations)[2][-1].reshape(3, 3)
    homography = np.linalg.inv(normal_image) @ solution @ normal_plane
    return np.asarray(homography / homography[2, 2])


def _normalizer(points: Array) -> Array:
    """Return the similarity (3, 3) that centres points (K, 2) and gives them a spread of 1."""
    middle, spread = points.mean(axis=0), points.std()
    shifted = np.array([[1.0, 0.0, -middle[0]], [0.0, 1.0, -middle[1]], [0.0, 0.0, spread]])
    return np.asarray(shifted / spread)


def _directions(slopes: Array, directions: ComplexArray) -> ComplexArray:
    """Return the images (K,) of plane directions (K,) by derivatives (K, 2, 2)."""
    mapped = (slopes @ to_points(directions)[:, :, None])[:, :, 0]
    return np.asarray(mapped[:, 0] + 1j * mapped[:, 1])


def _turns(homography: Array, points: ComplexArray | Array, yaws_rad: Array) -> Array:
    """Return the derivatives (K,) of image directions by directions in the plane."""
    slopes, ahead = derivatives(homography, points), np.exp(1j * yaws_rad)
    a, b = _directions(slopes, ahead), _directions(slopes, 1j * ahead)
    return np.asarray((a.conj() * b).imag / np.abs(a) ** 2)
