"""Nearby bodies in a unit's image, for the proximity message to the robots.

Lengths are in marker sides, the only length that images and robots have in common. Obstacles carry markers
like robots, but their ids are not in the template.

A marker with an unknown id, or with an id at several places, is a body without identity (`ANONYMOUS_ID`). It
has a robot's radius, and half of the gap is left to it, since it may be a robot that moves.
"""

from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, fields

import numpy as np

from skyherd.control.avoidance.image_border import HIDDEN_SIDES, HiddenBeyond
from skyherd.control.avoidance.make_way import yielding_sides
from skyherd.geometry import Array, ComplexArray, IntArray, to_complex, wrap_angle
from skyherd.messages import ANONYMOUS_ID, BORDER_IDS, Detections, Proximity, among
from skyherd.messages.checks import check_kind, check_numbers, check_vectors


@dataclass(frozen=True)
class BodyRule:
    """Sizes of bodies as units know them, in marker sides.

    Attributes:
        radius_sides: radius of a robot's round body about the centre of its marker.
        margin_sides: minimum gap between bodies.
        horizon_sides: maximum gap that is reported to robots.
        obstacles: radius of each obstacle, by the id of its marker.
    """

    radius_sides: float
    margin_sides: float = 0.2
    horizon_sides: float = 8.0
    obstacles: dict[int, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_numbers(self, not_negative=("radius_sides", "margin_sides"), positive=("horizon_sides",))


@dataclass(frozen=True)
class _Pairs:
    """P pairs of a robot, by its row, and a body to avoid; the other fields are as in `Proximity`."""

    rows: IntArray
    other_ids: IntArray
    directions: ComplexArray
    distances_sides: Array
    reaches_sides: Array
    shares: Array
    ways_sides: Array


def proximity(
    detections: Detections,
    team_ids: IntArray,
    rule: BodyRule,
    hidden: HiddenBeyond | None = None,
    *,
    ambiguous: AbstractSet[int] = frozenset(),
) -> Proximity:
    """Return all pairs of a robot and another body within the horizon, each in the robot's own frame.

    The bearing is `heading - arg(offset)`: image angles run clockwise seen from above, robot angles
    counter-clockwise.

    Args:
        detections: all markers in the image.
        team_ids: (N,) the robots.
        rule: radii, margin and horizon.
        hidden: the border of the image, if unseen robots may stand beyond it, and the robots that must avoid
            it.
        ambiguous: ids of markers that were recently at several places; ids repeated in the image always are.
    """
    check_kind("proximity: detections", detections, Detections, "detections")
    check_kind("proximity: rule", rule, BodyRule, "a rule of bodies")
    check_vectors("proximity", team_ids=team_ids)
    team = frozenset(team_ids.tolist())
    known = team | rule.obstacles.keys()
    ambiguous = ambiguous | detections.repeated_ids
    pairs = _pairs_of_bodies(detections, team, known - ambiguous, rule)
    if hidden is not None:
        at_border = _pairs_with_border(detections, ambiguous, hidden, rule)
        names = [field.name for field in fields(_Pairs)]
        pairs = _Pairs(*(np.concatenate([getattr(pairs, n), getattr(at_border, n)]) for n in names))
    return Proximity(
        unit_id=detections.unit_id,
        time_s=detections.time_s,
        horizon_sides=rule.horizon_sides,
        ids=_each_once(detections.ids[among(detections.ids, known)]),
        robot_ids=detections.ids[pairs.rows],
        other_ids=pairs.other_ids,
        distances_sides=pairs.distances_sides,
        bearings_rad=wrap_angle(detections.headings_rad[pairs.rows] - np.angle(pairs.directions)),
        reaches_sides=pairs.reaches_sides,
        shares=pairs.shares,
        ways_sides=pairs.ways_sides,
    )


def _each_once(ids: IntArray) -> IntArray:
    """Return ids, each at its first place."""
    return np.array(list(dict.fromkeys(ids.tolist())), dtype=np.int64)


def _pairs_of_bodies(
    bodies: Detections, team: frozenset[int], identified: AbstractSet[int], rule: BodyRule
) -> _Pairs:
    """Return the pairs of a robot and another body in the image; a body not `identified` is anonymous.

    A length in the image is divided by the mean side of the two markers, which is also correct under camera
    tilt.
    """
    points, sides = to_complex(bodies.centers_px), bodies.sides_px
    is_robot = among(bodies.ids, team)
    radii = np.array([rule.obstacles.get(body, rule.radius_sides) for body in bodies.ids.tolist()])
    offsets = points[None, :] - points[:, None]
    distances = np.abs(offsets) / ((sides[None, :] + sides[:, None]) / 2)
    reaches = radii[None, :] + radii[:, None] + rule.margin_sides
    near = is_robot[:, None] & (distances - reaches < rule.horizon_sides)
    np.fill_diagonal(near, False)
    robot, other = np.nonzero(near)
    certain = among(bodies.ids, identified)
    static = certain & ~is_robot
    gaps = distances - reaches
    np.fill_diagonal(gaps, np.inf)
    ways = yielding_sides(gaps, is_robot)
    return _Pairs(
        robot,
        np.where(certain[robot] & certain[other], bodies.ids[other], ANONYMOUS_ID),
        offsets[robot, other],
        distances[robot, other],
        reaches[robot, other],
        np.where(static[other], 1.0, 0.5),
        ways[robot, other],
    )


def _pairs_with_border(
    bodies: Detections, ambiguous: AbstractSet[int], hidden: HiddenBeyond, rule: BodyRule
) -> _Pairs:
    """Return the pairs of a robot and a side of the image.

    A hidden robot is assumed at the nearest unseen point behind each side.
    """
    depths = hidden.border.depths_px(to_complex(bodies.centers_px)) / bodies.sides_px[:, None]
    reach = 2 * rule.radius_sides + rule.margin_sides + HIDDEN_SIDES
    near = among(bodies.ids, hidden.concerned_ids)[:, None] & (depths - reach < rule.horizon_sides)
    robot, side = np.nonzero(near)
    return _Pairs(
        robot,
        np.where(among(bodies.ids, ambiguous)[robot], ANONYMOUS_ID, BORDER_IDS[side]),
        -hidden.border.normals[side],
        np.maximum(depths[robot, side], 0.0),
        np.full(robot.size, reach),
        np.ones(robot.size),
        np.zeros(robot.size),
    )
