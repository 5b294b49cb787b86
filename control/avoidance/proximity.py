"""Which bodies come near one another, as one unit sees them, and what it tells the robots of that."""

from dataclasses import dataclass, field

import numpy as np

from skyherd.geometry import IntArray, to_complex, wrap_angle
from skyherd.messages import Detections, Proximity


@dataclass(frozen=True)
class BodyRule:
    """What units know of bodies, in marker sides.

    Attributes:
        radius_sides: of a robot's round body about its marker's centre.
        margin_sides: bodies are kept apart by this.
        horizon_sides: robots hear of gaps up to this.
        obstacles: radius of each obstacle, by marker id.
    """

    radius_sides: float
    margin_sides: float = 0.2
    horizon_sides: float = 8.0
    obstacles: dict[int, float] = field(default_factory=dict)


def proximity(detections: Detections, team_ids: IntArray, rule: BodyRule) -> Proximity:
    """All pairs of a robot and another body within the horizon, in each robot's own frame.

    A length in the image is a number of marker sides by the mean side of the two markers, which holds
    under a tilt as well. The bearing is `heading - arg(offset)`: image angles run clockwise seen from above.
    """
    bodies = detections.select(np.union1d(team_ids, np.array(list(rule.obstacles), dtype=np.int64)))
    points, sides = to_complex(bodies.centers_px), bodies.sides_px
    is_robot = np.isin(bodies.ids, team_ids)
    radii = np.array([rule.obstacles.get(body, rule.radius_sides) for body in bodies.ids.tolist()])
    offsets = points[None, :] - points[:, None]
    distances = np.abs(offsets) / ((sides[None, :] + sides[:, None]) / 2)
    reaches = radii[None, :] + radii[:, None] + rule.margin_sides
    near = is_robot[:, None] & (distances - reaches < rule.horizon_sides)
    np.fill_diagonal(near, False)
    robot, other = np.nonzero(near)
    return Proximity(
        unit_id=bodies.unit_id,
        time_s=bodies.time_s,
        horizon_sides=rule.horizon_sides,
        ids=bodies.ids,
        robot_ids=bodies.ids[robot],
        other_ids=bodies.ids[other],
        distances_sides=distances[robot, other],
        bearings_rad=wrap_angle(bodies.headings_rad[robot] - np.angle(offsets[robot, other])),
        reaches_sides=reaches[robot, other],
        shares=np.where(is_robot[other], 0.5, 1.0),
    )
