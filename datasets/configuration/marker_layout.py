"""Several markers on each robot: their keys in scenario and lab files, and the checks of these keys."""

from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Annotated

import cv2
import numpy as np
from pydantic import Field, FiniteFloat

from skyherd.datasets.configuration.fields import Angle, Model
from skyherd.errors import InputError
from skyherd.geometry import ROBOT_FRAME_CORNERS, to_points
from skyherd.markers.dictionary import card_side, dictionary_size
from skyherd.markers.layout import FACES, Face, MarkerLayout, Place
from skyherd.messages.checks import check_kind

MAX_PLACES = 100
"""Maximum number of markers on a robot. Chosen: more than fit in an image."""

MIN_OVERLAP_SIDES2 = 1e-6
"""Area of overlap of two cards above which they are refused, marker sides squared. Chosen: far above the
rounding of cards that touch."""

SAME_PLANE_SIDES = 1e-6
"""Distance of two parallel markers above which one is not in the plane of the other, sides. Chosen: far above
rounding."""

OffsetSides = Annotated[FiniteFloat, Field(ge=-100, le=100)]
"""Offset of a marker on a robot, marker sides."""


HeightSides = Annotated[FiniteFloat, Field(ge=0, le=100)]
"""Height of a marker on a robot, marker sides."""


class RobotMarkerModel(Model):
    """One of several markers on each robot, on its top or its sides."""

    add_to_id: Annotated[int, Field(ge=0, lt=2**31)] = Field(
        0, description="its id is that of the robot plus this number"
    )
    offset_sides: tuple[OffsetSides, OffsetSides] = Field(
        (0.0, 0.0),
        description="marker sides; its centre (forward, left) from the robot's reference point",
    )
    yaw_deg: Angle = Field(
        0.0, description="deg; its direction on its face, counter-clockwise as seen from outside"
    )
    height_sides: HeightSides = Field(
        0.0, description="marker sides; height of its centre above the reference point"
    )
    face: Face = Field(
        "top", description="side of the robot; a marker on top points forward at a yaw of 0, others up"
    )

    def make(self) -> Place:
        """Return the place of the marker."""
        yaw_rad = float(np.radians(self.yaw_deg))
        return Place(self.add_to_id, self.offset_sides, yaw_rad, self.height_sides, self.face)


def make_layout(
    models: Sequence[RobotMarkerModel],
    robot_ids: Iterable[int],
    dictionary: str,
    *,
    key: str,
    dictionary_key: str,
) -> MarkerLayout | None:
    """Return the layout of all robots; None for one marker on each robot, at its reference point.

    Args:
        models: the markers on each robot.
        robot_ids: the robots.
        dictionary: name of the dictionary.
        key: key of `models` in the file.
        dictionary_key: key of the file that names the dictionary.

    Raises:
        InputError: two markers overlap, two robots share a marker, a marker is not in the dictionary, or
            below the reference point.
    """
    for model in models:
        check_kind("make_layout: models", model, RobotMarkerModel, "RobotMarkerModels")
    if not models:
        return None
    for (first, one), (second, other) in combinations(enumerate(models), 2):
        if one.add_to_id == other.add_to_id:
            what = f"{other.add_to_id}, as for {key}.{first}"
            raise InputError(f"{key}.{second}.add_to_id", what, "another number for each marker of a robot")
        if _overlap_sides2(one, other, dictionary) > MIN_OVERLAP_SIDES2:
            what = f"its card overlaps that of {key}.{first}"
            allowed = f"cards of {card_side(dictionary):.3g} marker sides that do not overlap"
            raise InputError(f"{key}.{second}.offset_sides", what, allowed)
    for number, model in enumerate(models):
        if model.make().lowest_sides < -SAME_PLANE_SIDES:
            what = f"{model.height_sides:g}, so that its lower edge is below the reference point"
            raise InputError(
                f"{key}.{number}.height_sides", what, "at least 0.5 for an upright marker on a side"
            )
    ids = sorted(robot_ids)
    try:
        layout = MarkerLayout.make(ids, [model.make() for model in models])
    except InputError as error:
        raise error.within(key) from None
    if (most := int(layout.ids.max())) >= (limit := dictionary_size(dictionary)):
        what = f"markers up to {most}, but {dictionary} has {limit} markers"
        raise InputError(key, what, f"smaller numbers in add_to_id, or a larger {dictionary_key}")
    return layout


def _overlap_sides2(one: RobotMarkerModel, other: RobotMarkerModel, dictionary: str) -> float:
    """Return the area of the overlap of two cards on one face, marker sides squared; 0 on two faces."""
    if one.face != other.face:
        return 0.0
    axes = np.array(FACES[one.face], dtype=float)
    outward = np.cross(*axes)
    cards, depths = [], []
    for frame in (one.make().frame, other.make().frame):
        corners = frame[:, 2] + card_side(dictionary) * to_points(ROBOT_FRAME_CORNERS) @ frame[:, :2].T
        cards.append((corners @ axes.T).astype(np.float32))
        depths.append(outward @ frame[:, 2])
    if abs(depths[0] - depths[1]) > SAME_PLANE_SIDES:
        return 0.0
    return float(cv2.intersectConvexConvex(cards[0], cards[1])[0])
