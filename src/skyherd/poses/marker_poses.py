"""Poses of single markers in a camera's axes, with covariances and both solutions of the planar ambiguity.

A marker has the robot's axes: x forward, y left, z out of its face. Its pose (R, t) takes a point of the
marker to the camera's axes, `x_camera = R x + t`. The pose minimizes the chi-squared of the corners,

    χ²(R, t) = rᵀ Σ⁻¹ r,    r = corners - projection(R, t),

with the 8 x 8 covariance Σ of the detector. Eight numbers minus six unknowns leave two degrees of freedom.
The covariance is `(Jᵀ Σ⁻¹ J)⁻¹` in the errors (δt, δθ): `t + δt`, and `exp([δθ]) R`, both in the camera's
axes.

A square far away looks alike in two poses, which are about mirror images in the line of sight. OpenCV's IPPE
(Collins and Bartoli, IJCV 109, 2014) gives both, and each is refined. The better one is reported with the
logarithm of its likelihood ratio to the other, `(χ²_other - χ²) / 2`. The two meet in a marker that is seen
from straight ahead.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from skyherd.geometry import (
    ROBOT_FRAME_CORNERS,
    SQUARE_CORNERS,
    Array,
    fit_squares,
    to_complex,
    to_points,
)
from skyherd.poses.calibration import Calibration

LATTICE = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 7)] * 2), axis=-1).reshape(-1, 2)
"""Points (49, 2) of a marker, in sides, that show how a lens bends it. Chosen: the grid of six cells."""

SAME_POSE_SIGMAS = 0.5
"""Two solutions are one if they differ by less, standard deviations. Chosen: far below the distance of two
minima, far above the tolerance of the optimizer."""

FRONTAL_TILT = 0.1
"""Tilt, rad, of starts beside a frontal pose. Chosen: the slope of χ² is not zero there."""

MIN_SINE = 1e-12
"""Smallest sine of an angle that is divided by; a frontal pose is its own mirror image."""

TOLERANCE = 1e-10
"""Relative tolerance of the optimizer. Chosen: far below a standard deviation."""

MIN_VARIANCE_PX2 = 1e-12
"""Added to the corners' variances, px². Chosen: it keeps exact corners, as of drawings, invertible."""

MARKER_CORNERS = np.concatenate([to_points(ROBOT_FRAME_CORNERS), np.zeros((4, 1))], axis=1)
"""Corners (4, 3) of a marker of side 1 in its own axes."""

_FORWARD_LEFT = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation from OpenCV's axes of a square (x right, y forward) to the marker's (x forward, y left)."""


@dataclass(frozen=True)
class MarkerPoses:
    """Poses of N markers in the camera's axes, the better of both solutions.

    Attributes:
        rotations: (N, 3, 3) rotations R from the marker's axes to the camera's.
        translations_m: (N, 3) positions t of the markers' centres.
        covariances: (N, 6, 6) of (δt, δθ), m and rad, of the reported solution.
        chi_squared: (N,) χ² of the corners, two degrees of freedom.
        log_ratios: (N,) logarithm of the likelihood of the reported pose over the other. Near 0 the data do
            not say how the marker is tilted, and the covariance does not hold.
        other_rotations: (N, 3, 3) of the other solution. Where χ² has one minimum, the mirror image of the
            reported pose.
        other_translations_m: (N, 3) of the other solution.
    """

    rotations: Array
    translations_m: Array
    covariances: Array
    chi_squared: Array
    log_ratios: Array
    other_rotations: Array
    other_translations_m: Array

    def tilts_rad(self) -> Array:
        """Return the angles (N,), rad, between the markers' normals and the lines of sight to them."""
        sight = -self.translations_m / np.linalg.norm(self.translations_m, axis=1, keepdims=True)
        return np.asarray(np.arccos(np.clip((self.rotations[:, :, 2] * sight).sum(axis=1), -1, 1)))


@dataclass(frozen=True)
class _Solution:
    rotation: Array
    translation: Array
    chi_squared: float
    information: Array


def marker_poses(
    corners_px: Array, covariances: Array, calibration: Calibration, side_m: float
) -> MarkerPoses:
    """Return the poses of markers of one image.

    Args:
        corners_px: (N, 4, 2) corners in the order of `skyherd.geometry.SQUARE_CORNERS`.
        covariances: (N, 8, 8) their covariances, px², as `skyherd.vision.measure_outlines` gives them.
        calibration: of the camera.
        side_m: side of the black squares.
    """
    pairs = [_both(*given, calibration, side_m) for given in zip(corners_px, covariances, strict=True)]
    first, second = ([pair[k] for pair in pairs] for k in range(2))
    count = len(pairs)
    return MarkerPoses(
        rotations=np.array([s.rotation for s in first]).reshape(count, 3, 3),
        translations_m=np.array([s.translation for s in first]).reshape(count, 3),
        covariances=np.array([np.linalg.inv(s.information) for s in first]).reshape(count, 6, 6),
        chi_squared=np.array([s.chi_squared for s in first]),
        log_ratios=np.array([(b.chi_squared - a.chi_squared) / 2 for a, b in pairs]),
        other_rotations=np.array([s.rotation for s in second]).reshape(count, 3, 3),
        other_translations_m=np.array([s.translation for s in second]).reshape(count, 3),
    )


def _both(corners_px: Array, covariance: Array, calibration: Calibration, side_m: float) -> list[_Solution]:
    """Return the better and the other solution of one marker, or its mirror image where there is no other."""
    starts = _starts(calibration.rays(corners_px), side_m)
    found = [_refined(*start, corners_px, covariance, calibration, side_m) for start in starts]
    found = sorted((s for s in found if s.translation[2] > 0), key=lambda s: s.chi_squared) or found
    best, other = found[0], found[-1]
    off = pose_difference(best.rotation, best.translation, other.rotation, other.translation)
    if off @ best.information @ off < SAME_POSE_SIGMAS**2:
        other = _mirrored(best, corners_px, covariance, calibration, side_m)
    return [best, other]


def _mirrored(
    one: _Solution, corners_px: Array, covariance: Array, calibration: Calibration, side_m: float
) -> _Solution:
    """Return the pose with the opposite tilt from the line of sight, and its χ²."""
    normal, sight = one.rotation[:, 2], -one.translation / np.linalg.norm(one.translation)
    mirrored = 2 * (sight @ normal) * sight - normal
    axis = np.cross(normal, mirrored)
    sine, cosine = float(np.linalg.norm(axis)), float(normal @ mirrored)
    turn = Rotation.from_rotvec(axis / max(sine, MIN_SINE) * np.arctan2(sine, cosine))
    rotation = turn.as_matrix() @ one.rotation
    seen = calibration.project(side_m * MARKER_CORNERS @ rotation.T + one.translation)
    seen = seen + lens_bend(rotation, one.translation, calibration, side_m)
    off = _whitening(covariance) @ (corners_px - seen).ravel()
    return _Solution(rotation, one.translation, float(off @ off), one.information)


def _whitening(covariance: Array) -> Array:
    """Return a matrix W (8, 8) with `W Σ Wᵀ = 1`."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance + MIN_VARIANCE_PX2 * np.eye(8))))


def _starts(rays: Array, side_m: float) -> list[tuple[Array, Array]]:
    """Return poses (R, t) from which the refinement begins: both solutions by OpenCV's IPPE."""
    square = np.concatenate([to_points(SQUARE_CORNERS) * (side_m, -side_m), np.zeros((4, 1))], axis=1)
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        square, np.ascontiguousarray(rays), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    starts: list[tuple[Array, Array]] = [
        (
            Rotation.from_rotvec(turn.ravel()).as_matrix() @ _FORWARD_LEFT.T,
            np.asarray(shift, dtype=float).ravel(),
        )
        for turn, shift in zip(turns, shifts, strict=True)
        if np.isfinite(turn).all() and np.isfinite(shift).all()
    ]
    return starts or _frontal_starts(rays, side_m)


def _frontal_starts(rays: Array, side_m: float) -> list[tuple[Array, Array]]:
    """Return poses on either side of the frontal one, for exact squares, of which IPPE has no pose."""
    square = fit_squares(to_complex(rays)[None])
    ahead = np.angle(square.similarities[0]) - np.pi / 2
    frontal = np.array([[np.cos(ahead), np.sin(ahead), 0], [np.sin(ahead), -np.cos(ahead), 0], [0, 0, -1]])
    center = np.array([*rays.mean(axis=0), 1.0]) * side_m / np.abs(square.similarities[0])
    turns = Rotation.from_rotvec([[FRONTAL_TILT, 0, 0], [-FRONTAL_TILT, 0, 0]]).as_matrix()
    return [(turn @ frontal, center) for turn in turns]


def _refined(
    rotation: Array,
    translation: Array,
    corners_px: Array,
    covariance: Array,
    calibration: Calibration,
    side_m: float,
) -> _Solution:
    """Return the minimum of χ² next to a pose, with the information (6, 6) on (δt, δθ)."""
    whiten = _whitening(covariance)
    bend = lens_bend(rotation, translation, calibration, side_m)

    def moved(step: Array) -> tuple[Array, Array]:
        turn = Rotation.from_rotvec(step[3:]).as_matrix()
        return turn @ rotation, translation + step[:3] * side_m

    def residuals(step: Array) -> Array:
        turned, shifted = moved(step)
        seen = calibration.project(side_m * MARKER_CORNERS @ turned.T + shifted) + bend
        return np.asarray(whiten @ (corners_px - seen).ravel())

    fit = least_squares(residuals, np.zeros(6), method="lm", x_scale=1.0, ftol=TOLERANCE, xtol=TOLERANCE)
    rotation, translation = moved(fit.x)
    weighted = whiten @ corner_jacobian(rotation, translation, calibration, side_m)
    return _Solution(rotation, translation, 2 * float(fit.cost), weighted.T @ weighted)


def corner_jacobian(rotation: Array, translation: Array, calibration: Calibration, side_m: float) -> Array:
    """Return the derivatives (8, 6) of a marker's corners, px, by (δt, δθ) of its pose, m and rad."""
    arms = side_m * MARKER_CORNERS @ rotation.T
    by_point = calibration.jacobians(arms + translation)
    by_turn = np.stack([by_point @ np.cross(axis, arms)[:, :, None] for axis in np.eye(3)], axis=-1)[:, :, 0]
    return np.concatenate([by_point, by_turn], axis=2).reshape(8, 6)


def pose_difference(rotation: Array, translation: Array, other: Array, other_translation: Array) -> Array:
    """Return (δt, δθ), (6,), by which the second pose differs from the first."""
    return np.concatenate(
        [other_translation - translation, Rotation.from_matrix(other @ rotation.T).as_rotvec()]
    )


def lens_bend(rotation: Array, translation: Array, calibration: Calibration, side_m: float) -> Array:
    """Return how far (4, 2), px, the corners of the nearest homography lie from those of the bent marker.

    A detector fits straight edges. A lens bends them, so that its corners are those of the homography that
    fits the whole marker best.
    """
    if not calibration.coefficients.size and not calibration.fisheye:
        return np.zeros((4, 2))
    points = np.concatenate([np.concatenate([LATTICE, np.zeros((len(LATTICE), 1))], axis=1), MARKER_CORNERS])
    seen = calibration.project(side_m * points @ rotation.T + translation)
    best, _ = cv2.findHomography(LATTICE, seen[: len(LATTICE)], 0)
    corners = np.concatenate([MARKER_CORNERS[:, :2], np.ones((4, 1))], axis=1) @ best.T
    return np.asarray(corners[:, :2] / corners[:, 2:] - seen[len(LATTICE) :])
