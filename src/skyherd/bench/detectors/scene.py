"""Scene of a cell: cameras, markers and their surroundings.

Markers follow smooth paths, slow enough for trackers.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skyherd.bench.detectors.design import Cell
from skyherd.geometry import ROBOT_FRAME_CORNERS, Array, IntArray, apply_homography
from skyherd.markers.dictionary import card_side, dictionary_size
from skyherd.render import Camera, CameraPose, Disc, Quad, homography_image_ground

FRAME_RATE_HZ = 30.0
"""Images a second of each camera."""

SPEED_PX, TURN_RAD = 3.0, 0.07
"""Maximum motion, px, and rotation, rad, of a marker between images: 90 px/s and 2 rad/s."""

FOCAL_SHARE = 1.0
"""Focal length in image widths: a horizontal field of view of 53 deg. It is longer under a steep tilt."""

MAX_OBLIQUE_DEG = 80.0
"""Largest angle between a ray of an image and the vertical. *Chosen*: at 90 it is the horizon."""

MAX_IDS = 50
"""Number of first markers of a dictionary that are used, so that ids are the same in all dictionaries."""

COVER_LEVEL = 40.0
"""Grey level of occluding discs: dark, and neither a marker's black nor its white."""


@dataclass(frozen=True)
class Team:
    """Markers on smooth paths about the points of a grid in the image, by index of the frame.

    Attributes:
        ids: (N,) ascending.
        homes_px: (N, 2) points of the grid.
        room_px: amplitude of the paths along u and v.
        phases_rad: (N, 2) initial phases.
        headings_rad: (N,) initial headings, on the ground.
        turns_rad: (N,) rotation per frame.
    """

    ids: IntArray
    homes_px: Array
    room_px: float
    phases_rad: Array
    headings_rad: Array
    turns_rad: Array

    def at(self, index: int) -> tuple[Array, Array]:
        """Return image points (N, 2), px, and ground headings (N,), rad, of the markers in a frame."""
        pace = np.array([1.0, 1.31]) * SPEED_PX / (2.0 * max(self.room_px, SPEED_PX))
        swing = np.sin(self.phases_rad + pace * index)
        return self.homes_px + self.room_px * swing, self.headings_rad + self.turns_rad * index


def make_team(cell: Cell, dictionary: str, rng: np.random.Generator) -> Team:
    """Place as many markers as fit without contact, up to `cell.markers`, at random."""
    width, height = cell.size_px
    # Under tilt the near half of the image shows larger markers.
    largest = cell.side_px * (1.0 + 2.0 * np.tan(np.radians(cell.tilt_deg)) * 0.5)
    around = max(card_side(dictionary), 1.0 + 2.0 * cell.touching)
    reach = largest * around * np.sqrt(2.0) + 4.0
    columns, rows = (max(1, min(4, int(length // reach))) for length in (width, height))
    spacing = np.array([width / columns, height / rows])
    column, row = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    homes = np.column_stack([column.ravel(), row.ravel()]) * spacing - 0.5
    count = min(cell.markers, len(homes), dictionary_size(dictionary))
    return Team(
        ids=np.sort(rng.permutation(min(dictionary_size(dictionary), MAX_IDS))[:count]),
        homes_px=homes[np.sort(rng.permutation(len(homes))[:count])],
        room_px=float(max(min(spacing) - reach, 1.0) / 2),
        phases_rad=rng.uniform(-np.pi, np.pi, (count, 2)),
        headings_rad=rng.uniform(-np.pi, np.pi, count),
        turns_rad=rng.uniform(-TURN_RAD, TURN_RAD, count),
    )


def focal_share(cell: Cell) -> float:
    """Return the focal length in image widths: `FOCAL_SHARE`, or longer to obey `MAX_OBLIQUE_DEG`."""
    half_diagonal = np.hypot(*cell.size_px) / (2.0 * cell.size_px[0])
    return max(FOCAL_SHARE, float(half_diagonal / np.tan(np.radians(MAX_OBLIQUE_DEG - cell.tilt_deg))))


def make_view(cell: Cell, rng: np.random.Generator) -> tuple[Camera, CameraPose]:
    """Return a camera at a random place that sees a marker of side 1 m at its centre with `cell.side_px`."""
    camera = Camera(cell.size_px, focal_px=focal_share(cell) * cell.size_px[0])
    tilt, toward = np.radians(cell.tilt_deg), rng.uniform(-np.pi, np.pi)
    # At the centre a tilted view shrinks by cos for the distance and by sqrt cos for the slant.
    height_m = camera.focal_px / cell.side_px * np.cos(tilt) ** 1.5
    about = (float(tilt * np.cos(toward)), float(tilt * np.sin(toward)))
    position = (float(rng.uniform(-20, 20)), float(rng.uniform(-20, 20)))
    return camera, CameraPose(
        position_m=position,
        height_m=float(height_m),
        yaw_rad=float(rng.uniform(-np.pi, np.pi)),
        tilt_rad=about,
    )


@dataclass(frozen=True)
class PlannedShot:
    """Scene of one image; markers have sides of 1 m.

    Attributes:
        unit_id: number of the camera.
        time_s: when it is taken.
        camera: its intrinsics.
        pose: where it is.
        blur_px: standard deviation of its lens's blur.
        ids: (N,) markers.
        positions_m: (N, 2) where they lie.
        headings_rad: (N,) their headings on the ground.
    """

    unit_id: int
    time_s: float
    camera: Camera
    pose: CameraPose
    blur_px: float
    ids: IntArray
    positions_m: Array
    headings_rad: Array


def camera_shots(cell: Cell, dictionary: str, unit: int, rng: np.random.Generator) -> Iterator[PlannedShot]:
    """Yield the shots of one static camera of a cell, in the order of time."""
    camera, pose = make_view(cell, rng)
    team = make_team(cell, dictionary, rng)
    ground_image: Array = np.asarray(np.linalg.inv(homography_image_ground(camera, pose)), dtype=np.float64)
    for index in range(cell.frames):
        points_px, headings = team.at(index)
        yield PlannedShot(
            unit_id=unit,
            time_s=index / FRAME_RATE_HZ,
            camera=camera,
            pose=pose,
            blur_px=cell.blur_of(unit),
            ids=team.ids,
            positions_m=apply_homography(ground_image, points_px),
            headings_rad=headings,
        )


def covering_discs(cell: Cell, shot: PlannedShot, rng: np.random.Generator) -> list[Disc]:
    """Return a disc about a random corner of each marker that covers `cell.occlusion` of the square."""
    if not cell.occlusion:
        return []
    radius = float(np.sqrt(4.0 * cell.occlusion / np.pi))
    corners = ROBOT_FRAME_CORNERS[rng.integers(0, 4, len(shot.ids))] * np.exp(1j * shot.headings_rad)
    places = shot.positions_m + np.column_stack([corners.real, corners.imag])
    return [Disc((float(x), float(y)), radius, COVER_LEVEL) for x, y in places]


def touching_squares(cell: Cell, shot: PlannedShot) -> list[Quad]:
    """Return black squares outside the markers, each of which touches its marker at one corner."""
    if not cell.touching:
        return []
    square = np.array([0.0, 1.0, 1.0 + 1.0j, 1.0j]) * cell.touching
    outwards = np.exp(1j * np.pi / 2 * np.arange(4))
    corners = (0.5 + 0.5j + square) * outwards[:, None]
    turned = corners * np.exp(1j * shot.headings_rad)[:, None, None]
    places = shot.positions_m[:, None, None] + np.stack([turned.real, turned.imag], axis=-1)
    return [Quad(quad, cell.black) for quad in places.reshape(-1, 4, 2)]
