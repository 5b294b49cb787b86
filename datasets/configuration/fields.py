"""Kinds of values that scenario files hold, with their ranges."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

Positive = Annotated[FiniteFloat, Field(gt=0, le=1e6)]
NotNegative = Annotated[FiniteFloat, Field(ge=0, le=1e6)]
Fraction = Annotated[FiniteFloat, Field(ge=0, lt=1)]
Coordinate = Annotated[FiniteFloat, Field(ge=-1e6, le=1e6)]
Point = tuple[Coordinate, Coordinate]


class Model(BaseModel):
    """Unknown keys are errors; values do not change after they are checked."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)
