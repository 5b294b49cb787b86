"""Scenario keys of the shapes to form."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from skyherd.datasets.configuration.fields import MAX_ROBOTS, Model, Point, Positive
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


class TemplateModel(ShapeModel):
    """The shape to form, and later shapes."""

    then: list[LaterModel] = Field([], max_length=100, description="later shapes, their times ascending")
