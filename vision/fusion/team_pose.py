"""Poses of upright robots in an image of a pinhole camera of unknown focal length, by least squares.

The camera has square pixels, and its principal point c is the middle of the image. All robots stand upright
on parallel planes, so that they share the rotation R_c from the ground's axes to the camera's. A point X of a
robot, in marker sides, has the image

    m = c + (p - c + σ q_xy) / (1 + σ κ q_z / S),    q = R_c R_z(θ) X,

with the robot's reference point at the pixel p, its heading θ on the ground, and σ the size of a marker side
at this point, px. S is the longer side of the image, and κ = S / f its ratio to the unknown focal length.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array, IntArray

KAPPA, KAPPA_STD = 1.0, 0.5
"""Expected ratio of the longer side of the image to the focal length, and its standard deviation. Chosen: a
field of view of 53° along this side, and from 28° to 74° within one standard deviation."""

MAX_STEPS, SETTLED = 20, 1e-3
"""Maximum number of steps of the fit, and the decrease of the sum of squares that ends it. Chosen: the next
step moves the estimate by about 0.03 of its standard deviation."""

DAMPING, MAX_DAMPING = 1e-3, 1e6
"""First and largest damping, as a share of the normal matrix's diagonal. Chosen, as is usual (Marquardt
1963)."""

SHARED, OWN = 3, 4
"""Unknowns of the image: κ and two small rotations of R_c. Unknowns of each robot: p (2), log σ and θ."""


@dataclass(frozen=True)
class Outlines:
    """Corners of K markers on R robots in an image.

    Attributes:
        corners_px: (K, 4, 2) corners.
        covariances: (K, 8, 8) their covariances, px².
        points: (K, 4, 3) the same corners in the robots' frames, marker sides.
        robots: (K,) rows of the robots, from 0.
        size_px: (2,) width and height of the image.
    """

    corners_px: Array
    covariances: Array
    points: Array
    robots: IntArray
    size_px: Array


@dataclass(frozen=True)
class TeamPose:
    """Poses of R robots in an image.

    Attributes:
        size_px: (2,) width and height of the image.
        kappa: ratio κ of the longer side of the image to the focal length.
        camera: R_c (3, 3), from the ground's axes to the camera's.
        places_px: (R, 2) reference points p.
        sizes_px: (R,) sizes σ.
        turns_rad: (R,) headings θ on the ground.
    """

    size_px: Array
    kappa: float
    camera: Array
    places_px: Array
    sizes_px: Array
    turns_rad: Array

    @property
    def middle_px(self) -> Array:
        """Principal point c (2,)."""
        return np.asarray((self.size_px - 1) / 2)

    @property
    def longer_px(self) -> float:
        """Longer side S of the image."""
        return float(self.size_px.max())

    def moved(self, step: Array) -> "TeamPose":
        """Return the poses moved by a step of the unknowns (3 + 4 R,)."""
        own = step[SHARED:].reshape(-1, OWN)
        return TeamPose(
            size_px=self.size_px,
            kappa=self.kappa + step[0],
            camera=self.camera @ small_rotation(np.array([*step[1:SHARED], 0.0])),
            places_px=self.places_px + own[:, :2],
            sizes_px=self.sizes_px * np.exp(own[:, 2].clip(-1, 1)),
            turns_rad=self.turns_rad + own[:, 3],
        )

    def images(self, points: Array, robots: IntArray) -> tuple[Array, Array, Array]:
        """Return images of points, and their derivatives by the shared unknowns and by those of their robot.

        Args:
            points: (K, P, 3) points in the robots' frames, marker sides.
            robots: (K,) the robot of each row of points.

        Returns:
            (K, P, 2) pixels, and derivatives (K, P, 2, 3) and (K, P, 2, 4).
        """
        ground = points @ about_vertical(self.turns_rad[robots]).transpose(0, 2, 1)
        q, rise = ground @ self.camera.T, self.kappa / self.longer_px
        sigma = self.sizes_px[robots][:, None]
        a = (self.places_px[robots] - self.middle_px)[:, None] + sigma[..., None] * q[..., :2]
        d = 1 + sigma * rise * q[..., 2]
        by_q = np.zeros((*d.shape, 2, 3))
        by_q[..., 0, 0] = by_q[..., 1, 1] = sigma / d
        by_q[..., 2] = -a * (sigma * rise / d**2)[..., None]
        turns = [_turned(ground, axis) @ self.camera.T for axis in range(3)]
        by_turns = by_q @ np.stack(turns, axis=-1)
        shared, own = np.zeros((*d.shape, 2, SHARED)), np.zeros((*d.shape, 2, OWN))
        shared[..., 0] = -a * (sigma * q[..., 2] / self.longer_px / d**2)[..., None]
        shared[..., 1:] = by_turns[..., :2]
        own[..., 0, 0] = own[..., 1, 1] = 1 / d
        own[..., 2] = (by_q @ q[..., None])[..., 0]
        own[..., 3] = by_turns[..., 2]
        return self.middle_px + a / d[..., None], shared, own

    def homographies(self) -> Array:
        """Return homographies (R, 3, 3) from each robot's plane (forward, left), marker sides, to pixels."""
        axes = self.sizes_px[:, None, None] * (self.camera @ about_vertical(self.turns_rad))[:, :, :2]
        weights = self.kappa / self.longer_px * axes[:, 2]
        homographies = np.ones((len(axes), 3, 3))
        homographies[:, :2, :2] = axes[:, :2] + self.middle_px[:, None] * weights[:, None]
        homographies[:, :2, 2] = self.places_px
        homographies[:, 2, :2] = weights
        return homographies

    def pose_covariances(self, errors: Array) -> Array:
        """Return covariances (R, 3, 3) of (u, v, heading), from that of the unknowns (3 + 4 R, 3 + 4 R).

        The heading is the direction of `q_xy - (p - c) κ q_z / S` for X forward.
        """
        rise, z = self.kappa / self.longer_px, np.array([0.0, 0.0, 1.0])
        covariances = np.zeros((self.sizes_px.size, 3, 3))
        for robot, turn in enumerate(about_vertical(self.turns_rad)):
            offset = self.places_px[robot] - self.middle_px
            project = np.column_stack([np.eye(2), -offset * rise])
            q = self.camera @ turn[:, 0]
            moves = np.zeros((2, SHARED + OWN))
            moves[:, 0] = -offset / self.longer_px * q[2]
            for column, axis in ((1, np.eye(3)[0]), (2, np.eye(3)[1]), (SHARED + 3, z)):
                moves[:, column] = project @ self.camera @ np.cross(axis, turn[:, 0])
            moves[:, SHARED : SHARED + 2] = -rise * q[2] * np.eye(2)
            ahead = project @ q
            by = np.zeros((3, SHARED + OWN))
            by[0, SHARED] = by[1, SHARED + 1] = 1.0
            by[2] = (ahead[0] * moves[1] - ahead[1] * moves[0]) / (ahead @ ahead)
            first = SHARED + OWN * robot
            rows = np.r_[0:SHARED, first : first + OWN]
            covariances[robot] = by @ errors[np.ix_(rows, rows)] @ by.T
        return covariances


def fit_team(start: TeamPose, outlines: Outlines) -> tuple[float, TeamPose, Array]:
    """Fit poses to corners by the method of Levenberg and Marquardt.

    Returns:
        The sum of squares, the poses, and the covariance (3 + 4 R, 3 + 4 R) of their unknowns.
    """
    roots = np.linalg.inv(np.linalg.cholesky(outlines.covariances))
    pose, damping = start, DAMPING
    cost, gradient, normal = _normal_equations(pose, outlines, roots)
    for _ in range(MAX_STEPS):
        damped = normal + damping * np.diag(np.diag(normal))
        step = np.asarray(np.linalg.solve(damped, gradient), dtype=float)
        moved = pose.moved(step)
        new = _normal_equations(moved, outlines, roots)
        if new[0] < cost:
            gain, damping = cost - new[0], damping / 10
            pose, (cost, gradient, normal) = moved, new
            if gain < SETTLED:
                break
        elif step @ gradient < SETTLED or damping > MAX_DAMPING:
            break
        else:
            damping *= 10
    return cost, pose, np.asarray(np.linalg.inv(normal), dtype=float)


def _normal_equations(pose: TeamPose, outlines: Outlines, roots: Array) -> tuple[float, Array, Array]:
    """Return the sum of squares, half its negative gradient, and the normal matrix.

    The square roots (K, 8, 8) of the inverse covariances make all residuals independent, of variance 1.
    """
    images, shared, own = pose.images(outlines.points, outlines.robots)
    count, robots = len(images), pose.sizes_px.size
    residuals = (roots @ (outlines.corners_px - images).reshape(count, 8, 1))[..., 0]
    shared, own = roots @ shared.reshape(count, 8, SHARED), roots @ own.reshape(count, 8, OWN)
    cross = np.einsum("kis,kio->kso", shared, own)
    normal = np.zeros((SHARED + OWN * robots,) * 2)
    gradient = np.zeros(len(normal))
    normal[:SHARED, :SHARED] = np.einsum("kis,kit->st", shared, shared)
    gradient[:SHARED] = np.einsum("kis,ki->s", shared, residuals)
    for row, robot in enumerate(outlines.robots.tolist()):
        part = slice(SHARED + OWN * robot, SHARED + OWN * (robot + 1))
        normal[part, part] += own[row].T @ own[row]
        normal[:SHARED, part] += cross[row]
        gradient[part] += own[row].T @ residuals[row]
    normal[SHARED:, :SHARED] = normal[:SHARED, SHARED:].T
    expected = (KAPPA - pose.kappa) / KAPPA_STD
    gradient[0] += expected / KAPPA_STD
    normal[0, 0] += 1 / KAPPA_STD**2
    return float((residuals**2).sum()) + expected**2, gradient, normal


def _turned(vectors: Array, axis: int) -> Array:
    """Return the cross product of a coordinate axis with vectors (..., 3)."""
    turned = np.zeros_like(vectors)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    turned[..., first], turned[..., second] = -vectors[..., second], vectors[..., first]
    return turned


def about_vertical(angles_rad: Array) -> Array:
    """Return rotations (N, 3, 3) about the third axis."""
    rotations = np.zeros((len(angles_rad), 3, 3))
    rotations[:, 0, 0] = rotations[:, 1, 1] = np.cos(angles_rad)
    rotations[:, 1, 0] = np.sin(angles_rad)
    rotations[:, 0, 1] = -rotations[:, 1, 0]
    rotations[:, 2, 2] = 1.0
    return rotations


def small_rotation(vector: Array) -> Array:
    """Return the rotation (3, 3) by a rotation vector (Rodrigues)."""
    x, y, z = vector
    angle, cross = float(np.linalg.norm(vector)), np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    first = np.sinc(angle / np.pi)
    second = np.sinc(angle / 2 / np.pi) ** 2 / 2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)
