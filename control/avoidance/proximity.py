"""Which bodies are near one another in a unit's image, for the message that the unit sends to the robots.

Lengths are in marker sides, the only length that images and robots have in common. Obstacles carry markers
like robots, but are not in the template; that is how they are told apart.
"""

from dataclasses import dataclass, field

import numpy as np

from skyherd.geometry import IntArray, to_complex, wrap_angle
from skyherd.messages import Detections, Proximity, among
from skyherd.messages.checks import check_numbers


@dataclass(frozen=True)
class BodyRule:
    """What units know of bodies, in marker sides.

    Attributes:
        radius_sides: radius of a robot's round body about the centre of its marker.
        margin_sides: gap that is kept free between bodies.
        horizon_sides: widest gap that is reported to robots.
        obstacles: radius of each obstacle, by the id of its marker.
    """

    radius_sides: float
    margin_sides: float = 0.2
    horizon_sides: float = 8.0
    obstacles: dict[int, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_numbers(self, not_negative=("radius_sides", "margin_sides"), positive=("horizon_sides",))


def proximity(detections: Detections, team_ids: IntArray, rule: BodyRule) -> Proximity:
    """All pairs of a robot and another body within the horizon, each in the robot's own frame.

    A length in the image is divided by the mean side of the two markers, which is right under a tilt of the
    camera as well. The bearing is `heading - arg(offset)`, since angles in the image run clockwise seen from
    above, and those of the robot counter-clockwise.

    Args:
        detections: all markers in the image.
        team_ids: (N,) the robots.
        rule: radii, margin and horizon.
    """
    team = frozenset(team_ids.tolist())
    bodies = detections.select(team | rule.obstacles.keys())
    points, sides = to_complex(bodies.centers_px), bodies.sides_px
    is_robot = among(bodies.ids, team)
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
