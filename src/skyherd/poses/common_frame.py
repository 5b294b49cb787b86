"""One frame for all markers and cameras: joint least squares over the corners of all views.

The frame is that of a reference marker: origin at its centre, x forward, y left, z out of its face. Unknown
are the pose of each view and of each other marker. A view is one image of a calibrated camera, so that a
moving camera gives several views, in which the markers of the frame stand still. Views are connected by the
markers that they share.

Errors are (δt, δθ), m and rad: of a marker `t + δt`, `exp([δθ]) R` in the frame's axes, of a camera likewise.
The covariance is the inverse of the normal matrix. The reference has no error by definition: the covariances
say how well the others are known relative to it. They are to first order: a reference whose own direction is
known badly moves far markers along arcs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from skyherd.errors import InputError
from skyherd.geometry import Array, IntArray
from skyherd.poses.calibration import Calibration
from skyherd.poses.marker_poses import (
    MARKER_CORNERS,
    MIN_VARIANCE_PX2,
    MarkerPoses,
    corner_jacobian,
    lens_bend,
    marker_poses,
)

AMBIGUOUS = float(np.log(1000.0))
"""Log-likelihood ratio below which the other solution of a marker is tried, too. Chosen."""

MAX_AMBIGUOUS = 4
"""Maximum number of markers of which both solutions are tried, the least certain. Chosen: 16 starts."""

OUTLIER_SHARE = 1e-6
"""Probability below which a fit does not explain the corners. Chosen: chance never reaches it; a marker that
moved or a wrong side does at once."""

TOLERANCE = 1e-10
"""Relative tolerance of the optimizer. Chosen: far below a standard deviation."""

RESECTIONS = 3
"""Rounds in which a camera is located in a frame. Chosen: the first begins at the pose by one marker."""

PLANAR = [0, 1, 5]
"""Components of (δt, δθ) of a marker on the reference's plane: x, y and yaw."""

Pose = tuple[Array, Array]
"""A rotation (3, 3) and a translation (3,), m."""


@dataclass(frozen=True)
class View:
    """Markers in one image of a calibrated camera.

    Attributes:
        name: name of the camera or image, for errors.
        calibration: of the camera.
        ids: (N,) markers, each once.
        corners_px: (N, 4, 2) their corners.
        covariances: (N, 8, 8) of the corners, px².
    """

    name: str
    calibration: Calibration
    ids: IntArray
    corners_px: Array
    covariances: Array

    def select(self, ids: Sequence[int]) -> "View":
        """Return the view with the markers of `ids` alone."""
        keep = np.isin(self.ids, list(ids))
        return View(
            self.name, self.calibration, self.ids[keep], self.corners_px[keep], self.covariances[keep]
        )


@dataclass(frozen=True)
class CommonFrame:
    """Poses of markers and cameras in the frame of a reference marker.

    Attributes:
        ids: (M,) markers, ascending; the reference among them.
        rotations: (M, 3, 3) of the markers' axes in the frame.
        positions_m: (M, 3) of the markers' centres.
        camera_rotations: (V, 3, 3) of the cameras' axes in the frame, a row for each view.
        camera_positions_m: (V, 3) of the projection centres.
        covariance: (6 M + 6 V, 6 M + 6 V) joint covariance of (δt, δθ): markers first, then cameras.
        chi_squared: of all corners.
        freedoms: its degrees of freedom.
    """

    ids: IntArray
    rotations: Array
    positions_m: Array
    camera_rotations: Array
    camera_positions_m: Array
    covariance: Array
    chi_squared: float
    freedoms: int

    @property
    def consistent(self) -> bool:
        """True if chance explains the residuals: no marker moved, and side and calibration fit."""
        return not self.freedoms or float(chdtrc(self.freedoms, self.chi_squared)) > OUTLIER_SHARE

    def marker_covariances(self) -> Array:
        """Return the covariances (M, 6, 6) of (δt, δθ) of the markers."""
        return np.array([self._block(row, row) for row in range(self.ids.size)]).reshape(-1, 6, 6)

    def camera_covariances(self) -> Array:
        """Return the covariances (V, 6, 6) of (δt, δθ) of the cameras."""
        rows = range(self.ids.size, self.ids.size + len(self.camera_positions_m))
        return np.array([self._block(row, row) for row in rows]).reshape(-1, 6, 6)

    def _block(self, row: int, column: int) -> Array:
        return self.covariance[6 * row : 6 * row + 6, 6 * column : 6 * column + 6]

    def in_camera(self, view: int) -> tuple[Array, Array, Array]:
        """Return all markers' poses in the axes of a view's camera.

        Returns:
            Rotations (M, 3, 3), translations (M, 3), m, and covariances (M, 6, 6) of (δt, δθ).
        """
        turn, center = self.camera_rotations[view].T, self.camera_positions_m[view]
        away = self.positions_m - center
        covariances = np.zeros((self.ids.size, 6, 6))
        both = np.zeros((6, 12))
        both[:3, :3] = both[3:, 3:6] = turn
        both[:3, 6:9] = both[3:, 9:] = -turn
        for row, arm in enumerate(away):
            both[:3, 9:] = turn @ _cross(arm)
            parts = [row, self.ids.size + view]
            joint = np.block([[self._block(a, b) for b in parts] for a in parts])
            covariances[row] = both @ joint @ both.T
        return turn @ self.rotations, away @ turn.T, covariances


def common_frame(
    views: Sequence[View], side_m: float, *, reference: int | None = None, coplanar: bool = False
) -> CommonFrame:
    """Return the poses of all markers and cameras in the frame of a reference marker.

    Args:
        views: at least one, connected by shared markers.
        side_m: side of the black squares.
        reference: marker whose axes are the frame's; the lowest id that most views share if None.
        coplanar: True if all markers lie on one plane, with the same height.

    Raises:
        InputError: the reference is in no view, or a view shares no marker with the others.
    """
    ids = np.unique(np.concatenate([view.ids for view in views])) if views else np.zeros(0, dtype=np.int64)
    if not ids.size:
        raise InputError("views", "show no marker", "at least one marker")
    counts = [sum(int(marker in view.ids) for view in views) for marker in ids]
    reference = int(ids[np.argmax(counts)]) if reference is None else reference
    if reference not in ids:
        raise InputError("reference", f"marker {reference} is in no view", f"one of {ids.tolist()}")
    seen = [marker_poses(v.corners_px, v.covariances, v.calibration, side_m) for v in views]
    fits = [
        _Fit(views, ids, reference, side_m, coplanar, *start).solved()
        for start in _starts(views, seen, ids, reference)
    ]
    return min(fits, key=lambda fit: fit.chi_squared)


def _starts(
    views: Sequence[View], seen: Sequence[MarkerPoses], ids: IntArray, reference: int
) -> list[tuple[list[Pose], list[Pose]]]:
    """Return poses of views (frame to camera) and of markers from which the fit begins, some alternatives.

    Poses are chained from the reference over the shared markers, the most certain ones first.
    """
    links = [
        (float(poses.log_ratios[row]), v, row)
        for v, (view, poses) in enumerate(zip(views, seen, strict=True))
        for row in range(view.ids.size)
    ]
    links.sort(key=lambda link: -link[0])
    doubtful = [link[1:] for link in reversed(links) if link[0] < AMBIGUOUS][:MAX_AMBIGUOUS]
    starts = []
    for flips in product([False, True], repeat=len(doubtful)):
        flipped = {link for link, flip in zip(doubtful, flips, strict=True) if flip}
        starts.append(_chained(views, seen, ids, reference, links, flipped))
    return starts


def _chained(
    views: Sequence[View],
    seen: Sequence[MarkerPoses],
    ids: IntArray,
    reference: int,
    links: Sequence[tuple[float, int, int]],
    flipped: set[tuple[int, int]],
) -> tuple[list[Pose], list[Pose]]:
    markers: dict[int, Pose] = {reference: (np.eye(3), np.zeros(3))}
    cameras: dict[int, Pose] = {}
    while len(markers) + len(cameras) < ids.size + len(views):
        for _, v, row in links:
            marker = int(views[v].ids[row])
            if (marker in markers) != (v in cameras):
                break
        else:
            lost = next(view.name for v, view in enumerate(views) if v not in cameras)
            raise InputError(
                lost, "shares no marker with the other views", "markers in the view of two cameras"
            )
        poses, other = seen[v], (v, row) in flipped
        turn = (poses.other_rotations if other else poses.rotations)[row]
        shift = (poses.other_translations_m if other else poses.translations_m)[row]
        if marker in markers:
            rotation, position = markers[marker]
            cameras[v] = turn @ rotation.T, shift - turn @ rotation.T @ position
        else:
            rotation, position = cameras[v]
            markers[marker] = rotation.T @ turn, rotation.T @ (shift - position)
    return [cameras[v] for v in range(len(views))], [markers[int(marker)] for marker in ids]


class _Fit:
    """Least squares of all corners, about given poses of views and markers."""

    def __init__(
        self,
        views: Sequence[View],
        ids: IntArray,
        reference: int,
        side_m: float,
        coplanar: bool,
        cameras: list[Pose],
        markers: list[Pose],
    ) -> None:
        self._views, self._ids, self._side_m = views, ids, side_m
        self._cameras, self._markers = cameras, markers
        free = PLANAR if coplanar else list(range(6))
        if coplanar:
            self._markers = [_on_plane(pose) for pose in markers]
        # Columns of the unknowns among all (δt, δθ): markers first, then cameras.
        self._columns = [
            *(6 * row + k for row, marker in enumerate(ids) if marker != reference for k in free),
            *range(6 * ids.size, 6 * (ids.size + len(views))),
        ]
        self._rows = [np.searchsorted(ids, view.ids) for view in views]
        self._whiten = [
            np.linalg.inv(np.linalg.cholesky(view.covariances + MIN_VARIANCE_PX2 * np.eye(8)))
            for view in views
        ]
        self._bends = [
            np.array([lens_bend(*self._seen(v, row), view.calibration, side_m) for row in rows]).reshape(
                -1, 4, 2
            )
            for v, (view, rows) in enumerate(zip(views, self._rows, strict=True))
        ]

    def _seen(self, view: int, row: int) -> Pose:
        """Return the pose of a marker in the axes of a view's camera."""
        (turn, shift), (rotation, position) = self._cameras[view], self._markers[row]
        return turn @ rotation, turn @ position + shift

    def _moved(self, step: Array) -> "tuple[list[Pose], list[Pose]]":
        full = np.zeros(6 * (self._ids.size + len(self._views)))
        full[self._columns] = step
        parts = full.reshape(-1, 6)
        turns = Rotation.from_rotvec(parts[:, 3:]).as_matrix()
        poses = [
            (turn @ rotation, position + part[:3])
            for turn, part, (rotation, position) in zip(
                turns, parts, [*self._markers, *self._cameras], strict=True
            )
        ]
        return poses[self._ids.size :], poses[: self._ids.size]

    def _residuals(self, step: Array) -> Array:
        cameras, markers = self._moved(step)
        rotations, positions = (np.array(part) for part in zip(*markers, strict=True))
        left = []
        for view, rows, whiten, bend, (turn, shift) in zip(
            self._views, self._rows, self._whiten, self._bends, cameras, strict=True
        ):
            corners = (
                self._side_m * MARKER_CORNERS @ rotations[rows].transpose(0, 2, 1) + positions[rows, None]
            )
            off = view.corners_px - view.calibration.project(corners @ turn.T + shift) - bend
            left.append((whiten @ off.reshape(-1, 8, 1)).ravel())
        return np.concatenate(left)

    def solved(self) -> CommonFrame:
        """Return the frame at the minimum of χ²."""
        start = np.zeros(len(self._columns))
        fit = least_squares(self._residuals, start, method="lm", ftol=TOLERANCE, xtol=TOLERANCE)
        self._cameras, self._markers = self._moved(fit.x)
        jacobian = self._jacobian()
        information = jacobian.T @ jacobian
        covariance = np.zeros((6 * (self._ids.size + len(self._views)),) * 2)
        covariance[np.ix_(self._columns, self._columns)] = np.linalg.inv(information)
        to_frame = np.eye(len(covariance))
        for v, (turn, shift) in enumerate(self._cameras):
            block = slice(6 * (self._ids.size + v), 6 * (self._ids.size + v) + 6)
            to_frame[block, block] = np.block(
                [[-turn.T, -turn.T @ _cross(shift)], [np.zeros((3, 3)), -turn.T]]
            )
        rotations, positions = (np.array(part) for part in zip(*self._markers, strict=True))
        turns, shifts = (np.array(part) for part in zip(*self._cameras, strict=True))
        return CommonFrame(
            ids=self._ids,
            rotations=rotations,
            positions_m=positions,
            camera_rotations=turns.transpose(0, 2, 1),
            camera_positions_m=-(turns.transpose(0, 2, 1) @ shifts[:, :, None])[:, :, 0],
            covariance=to_frame @ covariance @ to_frame.T,
            chi_squared=2 * float(fit.cost),
            freedoms=fit.fun.size - len(self._columns),
        )

    def _jacobian(self) -> Array:
        """Return the derivatives of the whitened corners by the unknowns, at the present poses."""
        count, begin = self._ids.size, 0
        jacobian = np.zeros((8 * sum(view.ids.size for view in self._views), 6 * (count + len(self._views))))
        for v, (view, rows, whiten) in enumerate(zip(self._views, self._rows, self._whiten, strict=True)):
            turn = self._cameras[v][0]
            for k, row in enumerate(rows):
                rotation, translation = self._seen(v, row)
                by_pose = whiten[k] @ corner_jacobian(rotation, translation, view.calibration, self._side_m)
                here = slice(begin, begin + 8)
                arm = turn @ self._markers[row][1]
                by_marker, by_camera = by_pose.copy(), by_pose.copy()
                by_marker[:, :3], by_marker[:, 3:] = by_pose[:, :3] @ turn, by_pose[:, 3:] @ turn
                by_camera[:, 3:] -= by_pose[:, :3] @ _cross(arm)
                jacobian[here, 6 * row : 6 * row + 6] = by_marker
                jacobian[here, 6 * (count + v) : 6 * (count + v) + 6] = by_camera
                begin += 8
        return jacobian[:, self._columns]


def _on_plane(pose: Pose) -> Pose:
    """Return the nearest pose on the plane z = 0 with its normal along z."""
    rotation, position = pose
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    return Rotation.from_euler("z", yaw).as_matrix(), position * (1, 1, 0)


def _cross(vector: Array) -> Array:
    """Return the matrix (3, 3) of `vector ×`."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def locate_camera(view: View, frame: CommonFrame, side_m: float) -> tuple[Array, Array, Array]:
    """Return the pose of a camera in a frame of fixed markers, from one image.

    The uncertainty of the markers' own poses in the frame is part of that of the corners.

    Args:
        view: image of the camera; markers that are not in the frame are ignored.
        frame: poses of the fixed markers.
        side_m: side of the black squares.

    Returns:
        Rotation (3, 3) of the camera's axes in the frame, position (3,), m, and covariance (6, 6) of
        (δt, δθ).

    Raises:
        InputError: the view shows none of the frame's markers.
    """
    view = view.select(frame.ids.tolist())
    if not view.ids.size:
        raise InputError(view.name, "shows no marker of the frame", f"one of {frame.ids.tolist()}")
    seen = marker_poses(view.corners_px, view.covariances, view.calibration, side_m)
    rows = np.searchsorted(frame.ids, view.ids)
    best = int(np.argmax(seen.log_ratios))
    candidates = [(seen.rotations[best], seen.translations_m[best])]
    candidates += [(seen.other_rotations[best], seen.other_translations_m[best])]
    starts = [
        _camera_by(pose, (frame.rotations[rows[best]], frame.positions_m[rows[best]])) for pose in candidates
    ]
    return min((_resected(view, frame, rows, start, side_m) for start in starts), key=lambda fit: fit[0])[1:]


def _camera_by(seen: Pose, marker: Pose) -> Pose:
    """Return the map from the frame to the camera, by a marker's pose in the camera and in the frame."""
    turn = seen[0] @ marker[0].T
    return turn, seen[1] - turn @ marker[1]


def _resected(
    view: View, frame: CommonFrame, rows: IntArray, start: Pose, side_m: float
) -> tuple[float, Array, Array, Array]:
    """Return χ² and the camera's pose with covariance, from markers of known poses."""
    turn, shift = start
    by_markers, by_camera = np.zeros((8 * rows.size, 6 * frame.ids.size)), np.zeros((8 * rows.size, 6))
    bends = np.zeros((rows.size, 4, 2))

    def derivatives(turn: Array, shift: Array) -> None:
        for k, row in enumerate(rows):
            pose = turn @ frame.rotations[row], turn @ frame.positions_m[row] + shift
            by_pose = corner_jacobian(*pose, view.calibration, side_m)
            here = slice(8 * k, 8 * k + 8)
            by_markers[here, 6 * row : 6 * row + 6] = np.hstack(
                [by_pose[:, :3] @ turn, by_pose[:, 3:] @ turn]
            )
            by_camera[here, :3] = by_pose[:, :3]
            by_camera[here, 3:] = by_pose[:, 3:] - by_pose[:, :3] @ _cross(turn @ frame.positions_m[row])
            bends[k] = lens_bend(*pose, view.calibration, side_m)

    own = np.zeros((8 * rows.size,) * 2)
    for k, covariance in enumerate(view.covariances):
        own[8 * k : 8 * k + 8, 8 * k : 8 * k + 8] = covariance + MIN_VARIANCE_PX2 * np.eye(8)
    of_markers = frame.covariance[: 6 * frame.ids.size, : 6 * frame.ids.size]
    corners = side_m * MARKER_CORNERS @ frame.rotations[rows].transpose(0, 2, 1)
    corners = corners + frame.positions_m[rows, None]

    def residuals(step: Array) -> Array:
        turned = Rotation.from_rotvec(step[3:]).as_matrix() @ turn
        seen = view.calibration.project(corners @ turned.T + shift + step[:3]) + bends
        return np.asarray(whiten @ (view.corners_px - seen).ravel())

    # The markers' errors enter by derivatives at the camera's pose, which each round knows better.
    for _ in range(RESECTIONS):
        derivatives(turn, shift)
        whiten = np.linalg.inv(np.linalg.cholesky(own + by_markers @ of_markers @ by_markers.T))
        fit = least_squares(residuals, np.zeros(6), method="lm", ftol=TOLERANCE, xtol=TOLERANCE)
        turn, shift = Rotation.from_rotvec(fit.x[3:]).as_matrix() @ turn, shift + fit.x[:3]
    derivatives(turn, shift)
    weighted = whiten @ by_camera
    to_frame = np.block([[-turn.T, -turn.T @ _cross(shift)], [np.zeros((3, 3)), -turn.T]])
    covariance = to_frame @ np.linalg.inv(weighted.T @ weighted) @ to_frame.T
    return 2 * float(fit.cost), turn.T, -turn.T @ shift, covariance
