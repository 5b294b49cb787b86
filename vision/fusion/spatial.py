"""Fusion of markers on several faces of robots, such as the sides of a cube.

One pinhole camera of unknown focal length and one vertical direction hold for the whole image. Least squares
over the corners of all markers, by their covariances, gives them and the pose of each robot (`team_pose`).
The fit begins from one or two vertical directions (`weak_perspective`); the better one counts.
"""

import numpy as np

from skyherd.geometry import Array, to_complex
from skyherd.markers.layout import MarkerLayout
from skyherd.messages import Detections
from skyherd.vision.fusion.robots import detections_of_robots, group_by_place
from skyherd.vision.fusion.team_pose import Outlines, fit_team
from skyherd.vision.fusion.weak_perspective import Slants, take_robots


def fuse_spatial_markers(
    found: Detections, corners_px: Array, covariances: Array, layout: MarkerLayout, others: Detections
) -> Detections:
    """Return the robots in an image, from the outlines of their markers; see `fuse_markers`.

    Args:
        found: detections of the K markers on robots.
        corners_px: (K, 4, 2) their corners.
        covariances: (K, 8, 8) covariances of the corners, px².
        layout: the markers on the robots.
        others: detections of markers that are on no robot.
    """
    if not len(found):
        return others
    size_px = np.asarray(found.image_size_px, dtype=float)
    rows = layout.rows_of(found.ids)
    frames, points, robots = layout.frames[rows], layout.points_sides[rows], layout.robot_ids[rows]
    slants = Slants.of_markers(corners_px, frames, size_px)
    tries = []
    for up in slants.verticals():
        single = slants.poses(up, frames)
        groups = group_by_place(robots, found.ids, to_complex(single.places_px), single.sizes_px)
        number = np.zeros(len(rows), dtype=np.int64)
        for index, members in enumerate(groups):
            number[members] = index
        largest = np.array([members[found.sides_px[members].argmax()] for members in groups])
        outlines = Outlines(corners_px, covariances, points, number, size_px)
        tries.append((len(groups), *fit_team(take_robots(single, largest), outlines), groups))
    _, _, pose, errors, groups = min(tries, key=lambda one: one[:2])
    known = np.array([found.covariances[members].any() for members in groups])
    return detections_of_robots(
        found,
        groups,
        np.array([robots[members[0]] for members in groups], dtype=np.int64),
        pose.homographies(),
        np.where(known[:, None, None], pose.pose_covariances(errors), 0.0),
        others,
    )
