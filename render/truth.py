"""Exact ground truth of the markers in an image: position, orientation, size and visibility.

`FrameTruth` is computed through the same `View` that draws the image, so that lens, motion and shutter are
the same. It is the reference for detectors, labelled image sets and recall.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from skyherd.geometry import ROBOT_FRAME_CORNERS, Array, BoolArray, IntArray, to_points
from skyherd.messages.checks import check_kind
from skyherd.render.camera.camera import Camera, CameraPose
from skyherd.render.camera.motion import INSTANT, STILL, Motion, Shutter
from skyherd.render.scene.occluders import Occluder
from skyherd.render.standing import shadows
from skyherd.render.view import ShapeImages, View

SQUARE: Array = to_points(ROBOT_FRAME_CORNERS)
"""Corners (4, 2) of a marker in marker coordinates (forward, left), in sides. *Derived* from the corner order
of `skyherd.geometry`."""

SAMPLES = 64
"""Sample points along a side for the visible fraction. *Derived*: an edge across the marker passes through
about 64 of 4096 cells, whose errors mostly cancel: the error is 0.002."""


@dataclass(frozen=True)
class FrameTruth:
    """Ground truth of the N markers of a team in one image.

    Attributes:
        ids: (N,) markers.
        centers_px: (N, 2) images of the markers' centres.
        corners_px: (N, 4, 2) images of the black squares' corners, in the marker's order.
        whole: (N,) True if the marker and its whole card are in the image and not covered.
        images: images of the markers, from marker coordinates (forward, left, in sides).
        count_visible: function that computes `visible_fractions`. It is called on demand, since it takes as
            long as all the rest.
    """

    ids: IntArray
    centers_px: Array
    corners_px: Array
    whole: BoolArray
    images: ShapeImages = field(repr=False, compare=False)
    count_visible: Callable[[], Array] = field(repr=False, compare=False)

    @cached_property
    def images_marker(self) -> Array:
        """Homographies (N, 3, 3) from marker coordinates (forward, left, in sides) to pixels.

        With a lens or a rolling shutter they are correct to first order at the centre.
        """
        return self.images.at_origin()

    @cached_property
    def _jacobians(self) -> Array:
        """Jacobians (N, 2, 2) of `images_marker` at the centres."""
        local, centers = self.images_marker, self.centers_px
        return np.asarray((local[:, :2, :2] - centers[:, :, None] * local[:, 2:, :2]) / local[:, 2:, 2:])

    @cached_property
    def headings_rad(self) -> Array:
        """Direction (N,) in the image, from +u to +v, of a marker's forward axis at its centre."""
        return np.arctan2(self._jacobians[:, 1, 0], self._jacobians[:, 0, 0])

    @cached_property
    def sides_px(self) -> Array:
        """Sides (N,) of the squares of equal area: `sqrt(|det J|)`, with the Jacobian J at the centre."""
        return np.asarray(np.sqrt(np.abs(np.linalg.det(self._jacobians))))

    @cached_property
    def visible_fractions(self) -> Array:
        """Fraction (N,) of the black square that is in the image and not covered."""
        return self.count_visible()


def ground_markers(positions_m: Array, headings_rad: Array, side_m: float) -> Array:
    """Return similarities (N, 3, 3) from marker coordinates (forward, left, in sides) to ground metres."""
    c, s = side_m * np.cos(headings_rad), side_m * np.sin(headings_rad)
    ground = np.zeros((len(headings_rad), 3, 3))
    ground[:, 0, 0] = ground[:, 1, 1] = c
    ground[:, 1, 0], ground[:, 0, 1] = s, -s
    ground[:, :2, 2], ground[:, 2, 2] = positions_m, 1.0
    return ground


def moving_markers(
    pose: CameraPose,
    positions_m: npt.ArrayLike,
    headings_rad: npt.ArrayLike,
    side_m: float,
    motion: Motion,
    frames: Array | None = None,
) -> Callable[[float], Array]:
    """Return the function from a time relative to the pose, s, to the markers on the ground at that time.

    They are homographies (N, 3, 3): `ground_markers`, or `shadows` for markers with frames on their robots.
    """
    positions, headings = np.asarray(positions_m, dtype=float), np.asarray(headings_rad, dtype=float)
    if frames is None:
        return lambda time_s: ground_markers(*motion.robots_at(positions, headings, time_s), side_m)
    return lambda time_s: shadows(
        motion.pose_at(pose, time_s), *motion.robots_at(positions, headings, time_s), side_m, frames
    )


def project_markers(
    camera: Camera,
    pose: CameraPose,
    positions_m: npt.ArrayLike,
    headings_rad: npt.ArrayLike,
    side_m: float,
    card_side_m: float,
    *,
    ids: npt.ArrayLike | None = None,
    frames: Array | None = None,
    motion: Motion = STILL,
    shutter: Shutter = INSTANT,
    occluders: Sequence[Occluder] = (),
) -> FrameTruth:
    """Project markers on the ground into a camera's image.

    With motion blur the result is that of the middle of the exposure. With a rolling shutter it is that of
    the row in which a point is seen.

    Args:
        camera: intrinsics and lens.
        pose: pose of the camera in the middle of the exposure of the middle row.
        positions_m: (N, 2) marker centres on the ground.
        headings_rad: (N,) forward directions of the markers, counter-clockwise from +x.
        side_m: side of the black square.
        card_side_m: side of the white card around it.
        ids: (N,) the markers; 0, 1, … if None.
        frames: (N, 3, 3) of markers on robots, as in `Shot`; None for markers flat on the ground.
        motion: velocities of camera and robots.
        shutter: exposure and row time.
        occluders: shapes over the markers.

    Returns:
        The ground truth of all N markers, including those outside the image.
    """
    check_kind("project_markers: camera", camera, Camera, "a Camera")
    check_kind("project_markers: pose", pose, CameraPose, "a CameraPose")
    check_kind("project_markers: motion", motion, Motion, "a Motion")
    check_kind("project_markers: shutter", shutter, Shutter, "a Shutter")
    view = View(camera, pose, motion, shutter)
    markers = moving_markers(pose, positions_m, headings_rad, side_m, motion, frames)
    images = view.images(markers)
    card = card_side_m / side_m
    points = images.project(np.concatenate([np.zeros((1, 2)), SQUARE, SQUARE * card]))
    centers, corners, cards = points[:, 0], points[:, 1:5], points[:, 5:]
    limit = np.array(camera.size_px) - 0.5
    inside = ((cards >= -0.5) & (cards <= limit)).all(axis=(1, 2)) & images.before_horizon(SQUARE * card)

    def unsure() -> IntArray:
        touches = ((cards.max(axis=1) >= -0.5) & (cards.min(axis=1) <= limit)).all(axis=1)
        ahead = images.before_horizon(np.zeros((1, 2)))
        return np.flatnonzero(ahead & touches & (~inside | bool(occluders)))

    def shares(rows: IntArray, side: float) -> Array:
        return _shares(images.only(rows), markers(0.0)[rows], occluders, side)

    whole = inside.copy()
    if occluders:
        rows = unsure()
        whole[rows] &= shares(rows, card) == 1.0

    def count_visible() -> Array:
        fractions, rows = inside.astype(float), unsure()
        fractions[rows] = shares(rows, 1.0)
        return fractions

    return FrameTruth(
        ids=np.arange(len(centers)) if ids is None else np.asarray(ids),
        centers_px=centers,
        corners_px=corners,
        whole=whole,
        images=images,
        count_visible=count_visible,
    )


def _shares(images: ShapeImages, grounds: Array, occluders: Sequence[Occluder], side: float) -> Array:
    """Return the fraction (M,) of squares that is in the image and not covered, sampled on a grid.

    Args:
        images: images of the M markers.
        grounds: (M, 3, 3) homographies from marker coordinates to ground metres.
        occluders: shapes over the markers.
        side: side of the squares, in marker sides.
    """
    line = ((np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5) * side
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    pixels = images.project(points)
    seen = ((pixels >= -0.5) & (pixels <= np.array(images.camera.size_px) - 0.5)).all(axis=-1)
    on_ground = points @ grounds[:, :2, :2].transpose(0, 2, 1) + grounds[:, None, :2, 2]
    on_ground /= points @ grounds[:, 2, :2, None] + grounds[:, 2:, 2:]
    for occluder in occluders:
        seen &= ~occluder.covers(on_ground)
    return np.asarray(seen.mean(axis=1))
