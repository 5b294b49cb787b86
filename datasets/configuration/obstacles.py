"""Checks of the obstacles of a scenario.

Obstacles are static round bodies with markers. They are rendered and detected like robots, but have no point
in the template. This is how the controller distinguishes them from robots.
"""

from collections.abc import Sequence

import numpy as np

from skyherd.datasets.configuration.robot_models import MarkerModel, ObstacleMarkerModel, ObstacleModel
from skyherd.errors import InputError
from skyherd.geometry import IntArray
from skyherd.markers.dictionary import dictionary_size


def check_obstacles(
    obstacles: Sequence[ObstacleModel], marker_ids: IntArray, robot_ids: IntArray, marker: MarkerModel
) -> None:
    """Check that each obstacle has its own marker, and that no marker covers another.

    Args:
        obstacles: the obstacles in the order of the file.
        marker_ids: (M,) markers of the robots.
        robot_ids: (M,) the robot of each.
        marker: keys of the markers.

    Raises:
        InputError: an id is that of a robot, of its marker or of another obstacle, or not in the dictionary;
            or the distance of two obstacles is less than a marker side.
    """
    check_obstacle_ids(obstacles, marker_ids, robot_ids, marker.dictionary, "marker.dictionary")
    for number, obstacle in enumerate(obstacles):
        where = f"obstacles.{number}"
        for other in obstacles[:number]:
            apart_m = float(np.hypot(*np.subtract(obstacle.position_m, other.position_m)))
            if apart_m < marker.side_m:
                what = f"{apart_m:.2g} m from obstacle {other.id}, so that one marker covers the other"
                raise InputError(f"{where}.position_m", what, f"at least {marker.side_m:g} m apart")


def check_obstacle_ids(
    obstacles: Sequence[ObstacleMarkerModel],
    marker_ids: Sequence[int] | IntArray,
    robot_ids: Sequence[int] | IntArray,
    dictionary: str,
    dictionary_key: str,
) -> None:
    """Check that each obstacle has its own marker.

    Args:
        obstacles: the obstacles in the order of the file.
        marker_ids: (M,) markers of the robots.
        robot_ids: (M,) the robot of each.
        dictionary: name of the dictionary.
        dictionary_key: key of the file that names the dictionary.

    Raises:
        InputError: an id is that of a robot, of its marker or of another obstacle, or not in the dictionary.
    """
    limit = dictionary_size(dictionary)
    taken = {int(robot): f"robot {robot}" for robot in robot_ids}
    taken |= {int(one): f"robot {robot}" for one, robot in zip(marker_ids, robot_ids, strict=True)}
    for number, obstacle in enumerate(obstacles):
        where = f"obstacles.{number}.id"
        if obstacle.id >= limit:
            what = f"{obstacle.id}, but {dictionary} has {limit} markers"
            raise InputError(where, what, f"an id from 0 to {limit - 1}, or a larger {dictionary_key}")
        if obstacle.id in taken:
            what = f"{obstacle.id} is the marker of {taken[obstacle.id]}"
            raise InputError(where, what, "a marker of its own")
        taken[obstacle.id] = f"obstacle {number}"
