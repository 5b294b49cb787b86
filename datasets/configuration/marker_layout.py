"""Several markers on each robot: their keys in scenario and lab files, and the checks of these keys."""

from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Annotated

import cv2
import numpy as np
from pydantic import Field, FiniteFloat

from skyherd.datasets.configuration.fields import Angle, Model
from skyherd.errors import InputError
from skyherd.geometry import ROBOT_FRAME_CORNERS
from skyherd.markers.dictionary import card_side, dictionary_size
from skyherd.markers.layout import MarkerLayout, Place
from skyherd.messages.checks import check_kind

MAX_PLACES = 100
"""Maximum number of markers on a robot. Chosen: more than fit in an image."""

MIN_OVERLAP_SIDES2 = 1e-6
"""Area of overlap of two cards above which they are refused, marker sides squared. Chosen: far above the
rounding of cards that touch."""

OffsetSides = Annotated[FiniteFloat, Field(ge=-100, le=100)]
"""Offset of a marker on a robot, marker sides."""


class RobotMarkerModel(Model):
    """One of several markers on each robot, in one plane parallel to the ground."""

    add_to_id: Annotated[int, Field(ge=0, lt=2**31)] = Field(
        0, description="its id is that of the robot plus this number"
    )
    offset_sides: tuple[OffsetSides, OffsetSides] = Field(
        (0.0, 0.0),
        description="marker sides; its centre (forward, left) from the robot's reference point",
    )
    yaw_deg: Angle = Field(0.0, description="deg; its direction on the robot, counter-clockwise")

    def make(self) -> Place:
        """Return the place of the marker."""
        return Place(self.add_to_id, self.offset_sides, float(np.radians(self.yaw_deg)))


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
        InputError: two markers overlap, two robots share a marker, or a marker is not in the dictionary.
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
    """Return the area of the overlap of two cards, marker sides squared."""
    cards = []
    for model in (one, other):
        place = model.make()
        turned = card_side(dictionary) * np.exp(1j * place.yaw_rad) * ROBOT_FRAME_CORNERS
        corners = complex(*place.offset_sides) + turned
        cards.append(np.stack([corners.real, corners.imag], axis=1).astype(np.float32))
    return float(cv2.intersectConvexConvex(cards[0], cards[1])[0])
