"""Kinds of values that scenario files hold, with their ranges."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

LARGEST = 1e6
"""Largest magnitude of a quantity in any unit. *Chosen*: beyond any real scene (1000 km, 11 days), so that a
slip of the decimal point is refused, and no square of it overflows."""

Positive = Annotated[FiniteFloat, Field(gt=0, le=LARGEST)]
"""A quantity above 0."""

NotNegative = Annotated[FiniteFloat, Field(ge=0, le=LARGEST)]
"""A quantity of 0 or more."""

Fraction = Annotated[FiniteFloat, Field(ge=0, lt=1)]
"""A share that is never the whole: 0 up to, but not, 1."""

Share = Annotated[FiniteFloat, Field(ge=0, le=1)]
"""A share from 0 to 1, both allowed."""

Coordinate = Annotated[FiniteFloat, Field(ge=-LARGEST, le=LARGEST)]
"""A coordinate of either sign."""

Point = tuple[Coordinate, Coordinate]
"""Two coordinates, (x, y) on the ground or (u, v) in an image."""


class Model(BaseModel):
    """Base of all models of scenario and data set files.

    Unknown keys are errors, and values do not change after they were checked.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)
