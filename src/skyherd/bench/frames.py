"""Frames with truth, made by our renderer: what every detector is shown.

A team of markers moves smoothly in front of a camera that stands still, a few pixels an image, so that
trackers can track. Any other source will do that gives `Frame`s for a cell, a dictionary and a seed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from skyherd.bench.design import Cell
from skyherd.bound import pose_covariances
from skyherd.geometry import Array, BoolArray, IntArray, apply_homography
from skyherd.markers import card_side, dictionary_size
from skyherd.optics import total_sigma_px
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, homography_image_ground

FRAME_RATE_HZ = 30.0
SPEED_PX, TURN_RAD = 3.0, 0.07
"""Most that a marker moves and turns from one image to the next: 90 px/s and 2 rad/s."""

FOCAL_SHARE = 1.0
"""Focal length in image widths: a field of view of 53 deg."""

ROUNDING_VARIANCE = 1.0 / 12.0
"""Variance of rounding to whole grey levels, which the bound counts as noise."""


@dataclass(frozen=True)
class Frame:
    """One image and the truth about it.

    Attributes:
        image: grey, (height, width).
        unit_id: the camera.
        time_s: when it was taken.
        ids: (N,) markers in view.
        centers_px: (N, 2) images of their centres.
        headings_rad: (N,) directions of their forward axes there.
        sides_px: (N,) their sides.
        whole: (N,) whether they are asked for: the marker and its card inside the image.
        bounds: (N, 3, 3) Cramér–Rao bound of (u, v, heading).
        blur_px: standard deviation of the lens's blur.
    """

    image: npt.NDArray[np.uint8]
    unit_id: int
    time_s: float
    ids: IntArray
    centers_px: Array
    headings_rad: Array
    sides_px: Array
    whole: BoolArray
    bounds: Array
    blur_px: float


class FrameSource(Protocol):
    """Makes the frames of a cell; the same arguments give the same frames."""

    def __call__(self, cell: Cell, dictionary: str, seed: int) -> Iterator[Frame]:
        """Frames of all cameras of the cell, each camera's in the order of time."""
        ...


@dataclass(frozen=True)
class Team:
    """Markers on smooth paths about the points of a grid in the image, by index of the frame.

    Attributes:
        ids: (N,) ascending.
        homes_px: (N, 2) points of the grid.
        rooms_px: amplitude of the paths.
        phases_rad: (N, 2) where on their path they begin.
        headings_rad: (N,) at the beginning, on the ground.
        turns_rad: (N,) turn from one frame to the next.
    """

    ids: IntArray
    homes_px: Array
    room_px: float
    phases_rad: Array
    headings_rad: Array
    turns_rad: Array

    def at(self, index: int) -> tuple[Array, Array]:
        """Image points (N, 2) to stand at in a frame, and headings (N,) on the ground."""
        pace = np.array([1.0, 1.31]) * SPEED_PX / (2.0 * max(self.room_px, SPEED_PX))
        swing = np.sin(self.phases_rad + pace * index)
        return self.homes_px + self.room_px * swing, self.headings_rad + self.turns_rad * index


def make_team(cell: Cell, dictionary: str, rng: np.random.Generator) -> Team:
    """As many markers as fit the image without ever touching, up to `cell.markers`."""
    width, height = cell.size_px
    # Under tilt the near half of the image shows larger markers.
    largest = cell.side_px * (1.0 + 2.0 * np.tan(np.radians(cell.tilt_deg)) * 0.5)
    reach = largest * card_side(dictionary) * np.sqrt(2.0) + 4.0
    columns, rows = (max(1, min(4, int(length // reach))) for length in (width, height))
    spacing = np.array([width / columns, height / rows])
    column, row = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    homes = np.column_stack([column.ravel(), row.ravel()]) * spacing - 0.5
    count = min(cell.markers, len(homes), dictionary_size(dictionary))
    return Team(
        ids=np.sort(rng.permutation(min(dictionary_size(dictionary), 50))[:count]),
        homes_px=homes[np.sort(rng.permutation(len(homes))[:count])],
        room_px=float(max(min(spacing) - reach, 1.0) / 2),
        phases_rad=rng.uniform(-np.pi, np.pi, (count, 2)),
        headings_rad=rng.uniform(-np.pi, np.pi, count),
        turns_rad=rng.uniform(-TURN_RAD, TURN_RAD, count),
    )


def make_view(cell: Cell, rng: np.random.Generator) -> tuple[Camera, CameraPose]:
    """A camera that sees a marker of side 1 m at the image's centre with `cell.side_px`."""
    camera = Camera(cell.size_px, focal_px=FOCAL_SHARE * cell.size_px[0])
    tilt, toward = np.radians(cell.tilt_deg), rng.uniform(-np.pi, np.pi)
    # At the centre a tilted view shrinks by cos for the distance and by sqrt cos for the slant.
    height_m = camera.focal_px / cell.side_px * np.cos(tilt) ** 1.5
    about = (float(tilt * np.cos(toward)), float(tilt * np.sin(toward)))
    position = (float(rng.uniform(-20, 20)), float(rng.uniform(-20, 20)))
    return camera, CameraPose(position, float(height_m), float(rng.uniform(-np.pi, np.pi)), about)


def rendered_frames(cell: Cell, dictionary: str, seed: int) -> Iterator[Frame]:
    """Frames of a cell from `skyherd.render`."""
    for unit in range(cell.cameras):
        rng = np.random.default_rng([seed, unit])
        yield from _camera_frames(cell, dictionary, unit, rng)


def _camera_frames(cell: Cell, dictionary: str, unit: int, rng: np.random.Generator) -> Iterator[Frame]:
    blur_px = cell.blur_of(unit)
    camera, pose = make_view(cell, rng)
    team = make_team(cell, dictionary, rng)
    ground = Ground(int(rng.integers(2**31)), sigma_px=total_sigma_px(blur_px))
    sensor = Sensor(cell.noise, np.random.default_rng(int(rng.integers(2**31))))
    renderer = Renderer(dictionary, 1.0, ground, sensor, psf_px=blur_px, black=cell.black, white=cell.white)
    homography = homography_image_ground(camera, pose)
    ground_image: Array = np.asarray(np.linalg.inv(homography), dtype=np.float64)
    for index in range(cell.frames):
        points_px, headings = team.at(index)
        positions = apply_homography(ground_image, points_px)
        image = renderer.render(camera, pose, team.ids, positions, headings)
        images_marker = homography @ ground_from_markers(positions, headings)
        yield Frame(
            image=image,
            unit_id=unit,
            time_s=index / FRAME_RATE_HZ,
            ids=team.ids,
            **poses_of(images_marker),
            whole=np.ones(len(team.ids), dtype=bool),
            bounds=pose_covariances(
                dictionary,
                team.ids,
                images_marker,
                psf_px=blur_px,
                noise=float(np.hypot(cell.noise, ROUNDING_VARIANCE**0.5)),
                black=cell.black,
                white=cell.white,
            ),
            blur_px=blur_px,
        )


def ground_from_markers(positions_m: Array, headings_rad: Array) -> Array:
    """Maps (N, 3, 3) from marker coordinates (forward, left) of markers of side 1 m to the ground."""
    c, s = np.cos(headings_rad), np.sin(headings_rad)
    one, zero = np.ones_like(c), np.zeros_like(c)
    x, y = positions_m.T
    return np.moveaxis(np.array([[c, -s, x], [s, c, y], [zero, zero, one]]), 2, 0)


def poses_of(images_marker: Array) -> dict[str, Array]:
    """Centres, headings and sides (N,) of markers whose homographies (N, 3, 3) to the image are known."""
    depth = images_marker[:, 2, 2]
    centers = images_marker[:, :2, 2] / depth[:, None]
    jacobian = (images_marker[:, :2, :2] - centers[:, :, None] * images_marker[:, 2:, :2]) / depth[
        :, None, None
    ]
    return {
        "centers_px": centers,
        "headings_rad": np.arctan2(jacobian[:, 1, 0], jacobian[:, 0, 0]),
        "sides_px": np.sqrt(np.abs(np.linalg.det(jacobian))),
    }
