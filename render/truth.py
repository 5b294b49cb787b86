"""Exact truth about the markers in an image: where they are, how they lie, how much of them is seen.

There is one truth: `FrameTruth` is computed through the same `View` that draws the image, so that lens,
motion and shutter cannot differ. Detectors, labelled image sets and recall are all judged by it.
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
from skyherd.render.view import ShapeImages, View

SQUARE: Array = to_points(ROBOT_FRAME_CORNERS)
"""Corners (4, 2) of a marker in its own coordinates: forward and left, in sides. *Derived* from the corner
order of `skyherd.geometry`."""

SAMPLES = 64
"""Points along a side on which the visible fraction is counted. *Derived*: an edge that cuts the marker
passes through some 64 of 4096 cells, whose errors mostly cancel: right to 0.002. Twice as many cost four
times as much."""


@dataclass(frozen=True)
class FrameTruth:
    """The markers of a team as one image has them, N of them: what a detector is judged by.

    Attributes:
        ids: (N,) markers.
        centers_px: (N, 2) images of the markers' centres.
        headings_rad: (N,) direction in the image, from +u to +v, of a marker's forward axis at its centre.
        sides_px: (N,) `sqrt(|det J|)`, J being the Jacobian of `images_marker` at the centre.
        corners_px: (N, 4, 2) images of the black squares' corners, in the marker's order.
        images_marker: (N, 3, 3) from marker coordinates (forward, left, in sides) to pixels; through a
            lens or a rolling shutter right to first order at the centre.
        whole: (N,) whether the marker and its whole card are in the image and not covered.
        count_visible: function that counts `visible_fractions`; called only if they are asked for, since that
            costs as much as all the rest.
    """

    ids: IntArray
    centers_px: Array
    headings_rad: Array
    sides_px: Array
    corners_px: Array
    images_marker: Array
    whole: BoolArray
    count_visible: Callable[[], Array] = field(repr=False, compare=False)

    @cached_property
    def visible_fractions(self) -> Array:
        """(N,) share of the black square that is in the image and not covered."""
        return self.count_visible()


def ground_markers(positions_m: Array, headings_rad: Array, side_m: float) -> Array:
    """Similarities (N, 3, 3) from marker coordinates (forward, left, in sides) to ground metres."""
    c, s = side_m * np.cos(headings_rad), side_m * np.sin(headings_rad)
    ground = np.zeros((len(headings_rad), 3, 3))
    ground[:, 0, 0] = ground[:, 1, 1] = c
    ground[:, 1, 0], ground[:, 0, 1] = s, -s
    ground[:, :2, 2], ground[:, 2, 2] = positions_m, 1.0
    return ground


def moving_markers(
    positions_m: npt.ArrayLike, headings_rad: npt.ArrayLike, side_m: float, motion: Motion
) -> Callable[[float], Array]:
    """Return function from an instant, s from the pose's, to `ground_markers` (N, 3, 3) as they are then."""
    positions, headings = np.asarray(positions_m, dtype=float), np.asarray(headings_rad, dtype=float)
    return lambda time_s: ground_markers(*motion.robots_at(positions, headings, time_s), side_m)


def project_markers(
    camera: Camera,
    pose: CameraPose,
    positions_m: npt.ArrayLike,
    headings_rad: npt.ArrayLike,
    side_m: float,
    card_side_m: float,
    *,
    ids: npt.ArrayLike | None = None,
    motion: Motion = STILL,
    shutter: Shutter = INSTANT,
    occluders: Sequence[Occluder] = (),
) -> FrameTruth:
    """Find where markers on the ground are in a camera's image.

    With motion blur the truth is that of the middle of the exposure, with a rolling shutter that of the row
    in which a point is seen.

    Args:
        camera: intrinsics and lens.
        pose: where the camera is in the middle of the exposure of the middle row.
        positions_m: (N, 2) markers' centres on the ground.
        headings_rad: (N,) their forward directions, counter-clockwise from +x.
        side_m: side of the black square.
        card_side_m: side of the white card around it.
        ids: (N,) the markers; 0, 1, … if not given.
        motion: velocities of camera and robots.
        shutter: exposure and row time.
        occluders: what lies over markers.

    Returns:
        The truth about all N markers, those outside the image as well.
    """
    check_kind("project_markers: camera", camera, Camera, "a Camera")
    check_kind("project_markers: pose", pose, CameraPose, "a CameraPose")
    check_kind("project_markers: motion", motion, Motion, "a Motion")
    check_kind("project_markers: shutter", shutter, Shutter, "a Shutter")
    view = View(camera, pose, motion, shutter)
    markers = moving_markers(positions_m, headings_rad, side_m, motion)
    images = view.images(markers)
    card = card_side_m / side_m
    points = images.project(np.concatenate([np.zeros((1, 2)), SQUARE, SQUARE * card]))
    centers, corners, cards = points[:, 0], points[:, 1:5], points[:, 5:]
    local = images.at_origin()
    jacobian = (local[:, :2, :2] - centers[:, :, None] * local[:, 2:, :2]) / local[:, 2:, 2:]
    limit, ahead = np.array(camera.size_px) - 0.5, images.before_horizon(np.zeros((1, 2)))
    inside = ((cards >= -0.5) & (cards <= limit)).all(axis=(1, 2))
    whole = np.asarray(inside & images.before_horizon(SQUARE * card))
    clear = np.where(whole, 1.0, 0.0)
    touches = ((cards.max(axis=1) >= -0.5) & (cards.min(axis=1) <= limit)).all(axis=1)
    unsure = np.flatnonzero(ahead & touches & (~whole | bool(occluders)))

    def shares(side: float) -> Array:
        return _shares(images.only(unsure), markers(0.0)[unsure], occluders, side)

    if occluders:
        whole[unsure] &= shares(card) == 1.0

    def count_visible() -> Array:
        fractions = clear.copy()
        fractions[unsure] = shares(1.0)
        return fractions

    return FrameTruth(
        ids=np.arange(len(centers)) if ids is None else np.asarray(ids),
        centers_px=centers,
        headings_rad=np.arctan2(jacobian[:, 1, 0], jacobian[:, 0, 0]),
        sides_px=np.sqrt(np.abs(np.linalg.det(jacobian))),
        corners_px=corners,
        images_marker=local,
        whole=whole,
        count_visible=count_visible,
    )


def _shares(images: ShapeImages, grounds: Array, occluders: Sequence[Occluder], side: float) -> Array:
    """Return share (M,) of squares of some side, in marker sides, that is in the image and not covered.

    Counted on a grid; `grounds` (M, 3, 3) are the squares' places on the ground.
    """
    line = ((np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5) * side
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    pixels = images.project(points)
    seen = ((pixels >= -0.5) & (pixels <= np.array(images.camera.size_px) - 0.5)).all(axis=-1)
    on_ground = points @ grounds[:, :2, :2].transpose(0, 2, 1) + grounds[:, None, :2, 2]
    for occluder in occluders:
        seen &= ~occluder.covers(on_ground)
    return np.asarray(seen.mean(axis=1))
