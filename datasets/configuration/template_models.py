"""Scenario keys of the shapes to form."""

import math
from typing import Annotated, Self

from pydantic import Field, FiniteFloat, model_validator

from skyherd.control import ShapeMotion
from skyherd.datasets.configuration.fields import MAX_ROBOTS, Model, NotNegative, Point, Positive
from skyherd.errors import InputError

PointNumber = Annotated[int, Field(ge=0, lt=MAX_ROBOTS)]
"""Number of a point in a list of points."""


class ShapeModel(Model):
    """Shape to form: exactly one of `points`, `shape` and `image`."""

    points: list[Point] | None = Field(
        None, max_length=MAX_ROBOTS, description="a point (x right, y up) for each robot, in any unit"
    )
    shape: str | None = Field(
        None, description="name of a shape (circle, grid, line, star, triangle), or a word such as word:SKY"
    )
    image: str | None = Field(
        None, description="picture with every robot's marker in it, relative to the scenario's folder"
    )

    outline: list[Annotated[list[PointNumber], Field(min_length=2, max_length=MAX_ROBOTS)]] | None = Field(
        None,
        max_length=MAX_ROBOTS,
        description="lines drawn in the video, beside `points`: each joins points by their numbers, from 0. "
        "A named shape has lines of its own",
    )

    @model_validator(mode="after")
    def _one(self) -> Self:
        given = [key for key in ("points", "shape", "image") if getattr(self, key) is not None]
        if len(given) != 1:
            what = f"{' and '.join(given)} given" if given else "no shape given"
            raise InputError("", what, "exactly one of points, shape and image")
        return self


class LaterModel(ShapeModel):
    """Shape that replaces the previous one."""

    at_s: Positive = Field(description="s; time at which it replaces the previous shape")


class MotionModel(Model):
    """Motion of the shape from a time on, in the frame of the template, which moves with the shape."""

    at_s: NotNegative = Field(description="s; time at which it replaces the previous motion")
    velocity_ps: Point = Field(
        (0.0, 0.0), description="1/s; velocity to the right and upwards, in RMS radii of the shape"
    )
    turn_degps: Annotated[FiniteFloat, Field(ge=-180, le=180)] = Field(
        0.0, description="deg/s; rotation, counter-clockwise seen from above"
    )
    growth_percent_ps: Annotated[FiniteFloat, Field(ge=-50, le=50)] = Field(
        0.0, description="%/s; growth of the shape"
    )

    @property
    def motion(self) -> ShapeMotion:
        """The motion in image sense."""
        right, up = self.velocity_ps
        turn_radps = -math.radians(self.turn_degps)
        return ShapeMotion(right, -up, turn_radps, self.growth_percent_ps / 100)


class TemplateModel(ShapeModel):
    """The shape to form, later shapes, and the motion of the shape."""

    then: list[LaterModel] = Field([], max_length=100, description="later shapes, their times ascending")
    motion: list[MotionModel] = Field(
        [], max_length=100, description="motions of the shape, their times ascending; it rests before"
    )
