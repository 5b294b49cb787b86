"""Scenario keys `roles`, `size` and `avoidance`: assignment, size of the shape, and collision avoidance."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from skyherd.control import Detour
from skyherd.datasets.configuration.fields import MAX_ROBOTS, Model, NotNegative, Positive
from skyherd.errors import InputError


class RolesModel(Model):
    """Assignment of the robots to the points of the template."""

    exchange: bool = Field(
        False,
        description="whether units exchange the robots' places in the shape, for shorter paths",
    )
    assigned: Literal["none", "similar", "parallel"] = Field(
        "none",
        description="assignment of the places at the start, from the true positions, to the nearest copy of "
        "the shape: of any turn (similar), or turned as the template (parallel); for comparisons",
    )
    period_s: Positive = Field(
        1.0, description="s; length of the time slot in which one unit at a time exchanges places"
    )
    gain: Annotated[float, Field(ge=0, lt=1)] = Field(
        0.05, description="smallest relative decrease of V, the cost of the fit, for an exchange"
    )
    classes: list[Annotated[int, Field(ge=0, lt=2**31)]] | None = Field(
        None,
        max_length=MAX_ROBOTS,
        description="a class number for each robot, by ascending id; robots exchange places only "
        "within a class",
    )


class SizeModel(Model):
    """Size of the shape; without any of these keys it is free, as in the paper."""

    min_spacing_sides: NotNegative = Field(
        0.0, description="marker sides; least distance between two robots in the finished shape; 0 for none"
    )
    spacing_sides: Positive | None = Field(
        None, description="marker sides; wanted distance between the two nearest robots in the finished shape"
    )
    unit_m: Positive | None = Field(None, description="m; wanted size of one unit of the template")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(value is not None for value in (self.spacing_sides, self.unit_m)) > 1:
            raise InputError("", "spacing_sides and unit_m given", "at most one of the two")
        return self


class AvoidanceModel(Model):
    """Collision avoidance between robots, whose bodies have the radius `robots.body_radius_sides`."""

    on: bool = Field(
        False, description="whether units send each robot the bodies near it, for collision avoidance"
    )
    detour: Detour = Field(
        "around",
        description="behaviour of a robot whose path is blocked: the best detour, circling the obstacle, the "
        "nearest safe velocity (a control barrier function), or stopping",
    )
    margin_sides: NotNegative = Field(0.2, description="marker sides; gap that is kept between two bodies")
    horizon_sides: Positive = Field(
        8.0, description="marker sides; largest gap to a body that units send to a robot"
    )
    lifetime_s: Positive = Field(
        2.0, description="s; a robot forgets a body this long after the last message about it"
    )
