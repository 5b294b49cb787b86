"""Checks the obstacles of a scenario.

Obstacles are round bodies with markers that never move. They are rendered and detected like robots, and stand
in no template: this is how the controller distinguishes them from robots.
"""

from collections.abc import Sequence

import numpy as np

from skyherd.datasets.configuration.robot_models import MarkerModel, ObstacleModel
from skyherd.errors import InputError
from skyherd.geometry import IntArray


def check_obstacles(
    obstacles: Sequence[ObstacleModel], robot_ids: IntArray, limit: int, marker: MarkerModel
) -> None:
    """Check that each obstacle has a marker of its own, and that none covers another.

    Raises:
        InputError: an id is a robot's, another obstacle's, or not below `limit`; or two obstacles are nearer
            to each other than a marker side.
    """
    taken = {int(robot): f"robot {robot}" for robot in robot_ids}
    for number, obstacle in enumerate(obstacles):
        where = f"obstacles.{number}"
        if obstacle.id >= limit:
            what = f"{obstacle.id}, but {marker.dictionary} has {limit} markers"
            raise InputError(
                f"{where}.id", what, f"an id from 0 to {limit - 1}, or a larger marker.dictionary"
            )
        if obstacle.id in taken:
            what = f"{obstacle.id} is the marker of {taken[obstacle.id]}"
            raise InputError(f"{where}.id", what, "a marker of its own")
        taken[obstacle.id] = f"obstacle {number}"
        for other in obstacles[:number]:
            apart_m = float(np.hypot(*np.subtract(obstacle.position_m, other.position_m)))
            if apart_m < marker.side_m:
                what = f"{apart_m:.2g} m from obstacle {other.id}, so that one marker covers the other"
                raise InputError(f"{where}.position_m", what, f"at least {marker.side_m:g} m apart")
