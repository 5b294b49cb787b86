"""Fusion of several markers on a robot into one detection of the robot.

The markers of a robot lie in one plane, at known places (`skyherd.markers.layout`). One homography G maps
this plane to the image. A first G is that of the marker nearest to the robot's reference point. It is then
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

A robot is detected if one of its markers is. Markers that do not agree on the robot's place are separate
detections of the robot, so that its id is repeated and counts as ambiguous.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import ROBOT_FRAME_CORNERS, Array, ComplexArray, IntArray, to_points, wrap_angle
from skyherd.markers.layout import MarkerLayout
from skyherd.messages import Detections, Quality
from skyherd.messages.checks import check_kind

SIZE_SHARE, ANISOTROPY_SHARE, PERSPECTIVE_SHARE = 0.35, 0.9, 0.025
"""Variances of a marker's log size, and of the plane's anisotropy and perspective (1/side²) times the number
of markers, over the variance of a heading, rad². Measured on 25 rendered images each of 6 and 30 markers of
4X4_50, tilts up to 40°: 0.30 and 0.34, 0.80 and 0.96, 0.027 and 0.023."""

MAX_PLANE_SHARE = 0.5
"""Maximum share of a heading's variance that is taken as the plane's. Chosen: it keeps the heading's own
variance positive with few markers."""

MAX_APART_SIDES = 0.5
"""Maximum distance between the robot's places by two of its markers, sides. Chosen: far above errors, and
below the distance of two robots."""

UNKNOWNS = 8
"""Unknowns of a homography of the plane: d (2), φ, s, a (2) and b (2), in this order."""


@dataclass(frozen=True)
class _RobotImage:
    """Homography (3, 3) from the robot's plane, sides, to pixels, with the covariance (3, 3) of the pose."""

    homography: Array
    covariance: Array


def fuse_markers(found: Detections, layout: MarkerLayout) -> Detections:
    """Return the robots in an image, from the detections of their markers.

    Centre, heading, side and corners are those of a marker of side 1 at the robot's reference point.
    Covariances are zero for robots of which all markers have none. The quality is the least of the markers'.
    Markers that are on no robot stay as they are, after the robots.

    Args:
        found: the markers in an image.
        layout: the markers on the robots.
    """
    check_kind("fuse_markers: found", found, Detections, "Detections")
    check_kind("fuse_markers: layout", layout, MarkerLayout, "a MarkerLayout")
    rows = np.array([layout.row_of.get(marker, -1) for marker in found.ids.tolist()], dtype=np.int64)
    on_robot = np.flatnonzero(rows >= 0)
    others = found[np.flatnonzero(rows < 0)]
    robots = [
        (robot, members)
        for robot in np.unique(layout.robot_ids[rows[on_robot]]).tolist()
        for members in _agreeing(found, layout, rows, on_robot[layout.robot_ids[rows[on_robot]] == robot])
    ]
    count = max(1, int((found.qualities == Quality.PHOTOMETRIC).sum()))
    plane = np.repeat([ANISOTROPY_SHARE, PERSPECTIVE_SHARE], 2) / count
    images = [_fuse(found[members], layout, rows[members], plane) for _, members in robots]
    corners = np.array([_apply(image.homography, ROBOT_FRAME_CORNERS) for image in images])
    centers = np.array([_apply(image.homography, np.zeros(1)) for image in images])
    slopes = np.array([_derivatives(image.homography, np.zeros(1))[0] for image in images]).reshape(-1, 2, 2)
    qualities = np.array([found.qualities[members].min() for _, members in robots], dtype=np.int64)
    count = len(robots)
    return Detections(
        unit_id=found.unit_id,
        time_s=found.time_s,
        image_size_px=found.image_size_px,
        ids=np.concatenate([np.array([robot for robot, _ in robots], dtype=np.int64), others.ids]),
        centers_px=np.concatenate([to_points(centers.reshape(count)), others.centers_px]),
        headings_rad=np.concatenate([np.arctan2(slopes[:, 1, 0], slopes[:, 0, 0]), others.headings_rad]),
        sides_px=np.concatenate([np.sqrt(np.abs(np.linalg.det(slopes))), others.sides_px]),
        corners_px=np.concatenate([to_points(corners.reshape(count, 4)), others.corners_px]),
        covariances=np.concatenate(
            [np.array([image.covariance for image in images]).reshape(-1, 3, 3), others.covariances]
        ),
        qualities=np.concatenate([qualities, others.qualities]),
    )


def _agreeing(found: Detections, layout: MarkerLayout, rows: IntArray, members: IntArray) -> list[IntArray]:
    """Return groups of a robot's detections (K,) that agree on its place, with each marker once."""
    groups: list[list[int]] = []
    places: list[complex] = []
    for member in members.tolist():
        homography = _fit(layout.corners_sides[rows[member]], found.corners_px[member])
        place = complex(_apply(homography, np.zeros(1))[0])
        reach_px = MAX_APART_SIDES * found.sides_px[member]
        for group, other in zip(groups, places, strict=True):
            if abs(place - other) <= reach_px and found.ids[member] not in found.ids[group]:
                group.append(member)
                break
        else:
            groups.append([member])
            places.append(place)
    return [np.array(group) for group in groups]


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
    by_state[:2] = _derivatives(homography, origin)[0] @ _moves(origin, middle)[0]
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
    slopes, turns = _derivatives(start, offsets), _turns(start, offsets, yaws_rad)
    own = np.array(
        [
            _derivatives(_fit(corners, points), offset[None])[0]
            for corners, points, offset in zip(
                layout.corners_sides[rows], seen.corners_px, offsets, strict=True
            )
        ]
    )
    residuals = np.zeros((len(rows), 4))
    residuals[:, :2] = seen.centers_px - to_points(_apply(start, offsets))
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


def _apply(homography: Array, points: ComplexArray | Array) -> ComplexArray:
    """Return the images (K,) of plane points (K,), `u + iv`."""
    mapped = _homogeneous(points) @ homography.T
    return np.asarray((mapped[:, 0] + 1j * mapped[:, 1]) / mapped[:, 2])


def _homogeneous(points: ComplexArray | Array) -> Array:
    return np.stack([points.real, points.imag, np.ones(len(points))], axis=1)


def _derivatives(homography: Array, points: ComplexArray | Array) -> Array:
    """Return the derivatives (K, 2, 2) of a homography at plane points (K,)."""
    mapped = _homogeneous(points) @ homography.T
    depth = mapped[:, 2, None, None]
    pixels = mapped[:, :2, None] / depth
    return np.asarray((homography[:2, :2] - pixels * homography[2, :2]) / depth)


def _directions(slopes: Array, directions: ComplexArray) -> ComplexArray:
    """Return the images (K,) of plane directions (K,) by derivatives (K, 2, 2)."""
    mapped = (slopes @ to_points(directions)[:, :, None])[:, :, 0]
    return np.asarray(mapped[:, 0] + 1j * mapped[:, 1])


def _turns(homography: Array, points: ComplexArray | Array, yaws_rad: Array) -> Array:
    """Return the derivatives (K,) of image directions by directions in the plane."""
    slopes, ahead = _derivatives(homography, points), np.exp(1j * yaws_rad)
    a, b = _directions(slopes, ahead), _directions(slopes, 1j * ahead)
    return np.asarray((a.conj() * b).imag / np.abs(a) ** 2)
