"""Survey of views: one frame for all markers, or for fixed ones, in which each picture is located."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array
from skyherd.poses import CommonFrame, View, common_frame, marker_poses

MAX_VARIANCE_FACTOR = 4.0
"""Largest factor by which residuals may exceed the variance of the image noise. Chosen: compression and what
a calibration leaves of a lens double the errors at most; a marker that moved exceeds it by far."""


@dataclass(frozen=True)
class MarkerPose:
    """Pose of one marker in the frame.

    Attributes:
        id: id of the marker.
        view: name of the picture in which it had this pose; None for a marker of the frame.
        rotation: (3, 3) of the marker's axes in the frame.
        position_m: (3,) of its centre.
        covariance: (6, 6) of (δt, δθ), m and rad.
    """

    id: int
    view: str | None
    rotation: Array
    position_m: Array
    covariance: Array


@dataclass(frozen=True)
class CameraPose:
    """Pose of the camera of one picture in the frame.

    Attributes:
        view: name of the picture.
        rotation: (3, 3) of the camera's axes in the frame.
        position_m: (3,) of the projection centre.
        covariance: (6, 6) of (δt, δθ), m and rad.
    """

    view: str
    rotation: Array
    position_m: Array
    covariance: Array


@dataclass(frozen=True)
class Survey:
    """Markers and cameras in one frame.

    Attributes:
        reference: marker whose axes are those of the frame.
        side_m: side of the markers.
        markers: markers of the frame by id, then the others by picture.
        cameras: the cameras, a row for each picture.
        frame: the joint fit, with covariances of the image noise alone.
        variance_factor: factor by which all other covariances exceed those of the image noise: χ² over its
            degrees of freedom, or 1 if chance explains the residuals.
    """

    reference: int
    side_m: float
    markers: list[MarkerPose]
    cameras: list[CameraPose]
    frame: CommonFrame
    variance_factor: float

    @property
    def is_consistent(self) -> bool:
        """True if no marker moved, and side and calibration fit."""
        return self.variance_factor <= MAX_VARIANCE_FACTOR


def survey(
    views: Sequence[View],
    side_m: float,
    *,
    reference: int | None = None,
    fixed: Sequence[int] | None = None,
    coplanar: bool = False,
) -> Survey:
    """Return the poses of all markers and cameras in one frame.

    Args:
        views: pictures with their markers, connected by shared markers of the frame.
        side_m: side of the black squares.
        reference: marker whose axes are the frame's. If None, of the markers of the frame that of the lowest
            id that most pictures show.
        fixed: markers that stand still over all pictures, and form the frame. The others have a pose for each
            picture. None if all stand still.
        coplanar: True if the markers of the frame lie on one plane.

    Raises:
        InputError: a picture shows no marker of the frame, or shares none with the other pictures.
    """
    of_frame = list(views) if fixed is None else [view.select(fixed) for view in views]
    for view in of_frame:
        if not view.ids.size:
            raise InputError(
                view.name, "shows no marker of `fixed=`", "markers that it shows, or leave it out"
            )
    frame = common_frame(of_frame, side_m, reference=reference, coplanar=coplanar)
    factor = 1.0 if frame.consistent else frame.chi_squared / frame.freedoms
    # The reference has no error by definition.
    spread = np.diagonal(frame.marker_covariances(), axis1=1, axis2=2).sum(axis=1)
    markers = [
        MarkerPose(int(marker), None, *pose)
        for marker, *pose in zip(
            frame.ids, frame.rotations, frame.positions_m, factor * frame.marker_covariances(), strict=True
        )
    ]
    cameras = [
        CameraPose(view.name, *pose)
        for view, *pose in zip(
            views,
            frame.camera_rotations,
            frame.camera_positions_m,
            factor * frame.camera_covariances(),
            strict=True,
        )
    ]
    if fixed is not None:
        for view, camera in zip(views, cameras, strict=True):
            markers += _moving(view, camera, fixed, side_m, factor)
    return Survey(int(frame.ids[np.argmin(spread)]), side_m, markers, cameras, frame, factor)


def _moving(
    view: View, camera: CameraPose, fixed: Sequence[int], side_m: float, factor: float
) -> list[MarkerPose]:
    """Return the poses of the markers of a view that are not of the frame.

    The errors of camera and marker are independent, since the marker is not in the fit of the camera:

        Σ = J Σ_camera Jᵀ + R Σ_marker Rᵀ,    J = [[I, -[R t]×], [0, I]]

    with the camera's rotation R and the marker's place t in its axes.
    """
    view = view.select(sorted(set(view.ids.tolist()) - set(fixed)))
    if not view.ids.size:
        return []
    seen = marker_poses(view.corners_px, view.covariances, view.calibration, side_m)
    turn, poses = camera.rotation, []
    both = np.kron(np.eye(2), turn)
    for marker, rotation, place, own in zip(
        view.ids, seen.rotations, seen.translations_m, seen.covariances, strict=True
    ):
        x, y, z = turn @ place
        by_camera = np.eye(6)
        by_camera[:3, 3:] = -np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        covariance = by_camera @ camera.covariance @ by_camera.T + factor * both @ own @ both.T
        position_m = camera.position_m + turn @ place
        poses.append(MarkerPose(int(marker), view.name, turn @ rotation, position_m, covariance))
    return poses
