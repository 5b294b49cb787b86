"""What the cameras could see of the robots, from ground truth: views, marker sides, and radii."""

from dataclasses import dataclass

import numpy as np

from skyherd.analysis.history import History
from skyherd.datasets import Mission
from skyherd.geometry import Array, BoolArray, apply_homography
from skyherd.markers.dictionary import card_side, sides_of_corners
from skyherd.messages.detections import centred
from skyherd.render import homography_image_ground, project_team
from skyherd.sim.world import Fleet

MIN_MARKER_PX = 12.0
"""Side of a marker in an image, px, below which robots are often missed. Chosen: the detector finds most
markers of 12 px in noise and blur, and few of 7 px."""


@dataclass(frozen=True)
class Views:
    """Robots (N) in the images of the units (U) at one instant.

    Attributes:
        in_view: (U, N) True where the robot's whole card is in the image.
        sides_px: (U, N) sides of the markers in view; NaN elsewhere.
        radii: (U, N) distance from the image centre, in halves of the image's shorter side, without lens
            distortion; infinite behind the camera.
    """

    in_view: BoolArray
    sides_px: Array
    radii: Array


def views_of(
    mission: Mission, fleet: Fleet, positions_m: Array, headings_rad: Array, time_s: float = 0.0
) -> Views:
    """Return the views of robots at positions (N, 2), m, with headings (N,), by the cameras at a time, s."""
    scenario = mission.scenario
    pairs = [(camera, fleet.pose(unit)) for unit, camera in enumerate(mission.cameras_at(time_s))]
    sides_px, radii = np.full((2, len(pairs), len(positions_m)), np.nan)
    side_m = scenario.marker.side_m
    card_m = side_m * card_side(scenario.marker.dictionary)
    for unit, image in enumerate(project_team(pairs, positions_m, headings_rad, side_m, card_m)):
        sides_px[unit, image.rows] = sides_of_corners(image.corners_px)
    for unit, (camera, pose) in enumerate(pairs):
        matrix = homography_image_ground(camera, pose)
        ahead = positions_m @ matrix[2, :2] + matrix[2, 2] > 0
        points_px = apply_homography(matrix, positions_m)
        from_center = np.linalg.norm(centred(points_px, np.array(camera.size_px)), axis=1)
        radii[unit] = np.where(ahead, from_center, np.inf)
    return Views(np.isfinite(sides_px), sides_px, radii)


def views_at(history: History, row: int) -> Views:
    """Return the views at one step of a run."""
    seen = history.positions_m[row], history.headings_rad[row]
    return views_of(history.mission, history.fleet(row), *seen, float(history.times_s[row]))
