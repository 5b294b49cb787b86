"""Scenario keys of bodies: who takes which place, how large the shape is, how robots keep apart."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from skyherd.control import Detour
from skyherd.datasets.configuration.fields import Model, NotNegative, Positive


class RolesModel(Model):
    """Which robot takes which point of the template."""

    exchange: bool = Field(False, description="units exchange the robots' places, so that ways are short")
    period_s: Positive = Field(1.0, description="one unit at a time may exchange, for so long")
    gain: Annotated[float, Field(ge=0, lt=1)] = Field(
        0.05, description="an exchange must lower V by this share"
    )
    classes: list[int] | None = Field(
        None, description="a class for each robot, by ascending id; they exchange within theirs"
    )


class SizeModel(Model):
    """How large the shape may be; free, as in the paper, where nothing is given."""

    least_spacing_sides: NotNegative = Field(
        0.0, description="least distance between two robots of the shape, in marker sides"
    )
    spacing_sides: Positive | None = Field(
        None, description="wanted distance between the two nearest robots of the shape, in marker sides"
    )
    unit_m: Positive | None = Field(None, description="wanted size, metres a template unit")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(value is not None for value in (self.spacing_sides, self.unit_m)) > 1:
            raise ValueError("give one of spacing_sides and unit_m")
        return self


class AvoidanceModel(Model):
    """How robots keep apart; bodies are of `robots.body_radius_sides`."""

    on: bool = Field(False, description="units tell robots of bodies near them")
    detour: Detour = Field(
        "around",
        description="a barred robot takes the best of all ways, or circles what bars it, or only stops",
    )
    margin_sides: NotNegative = Field(0.2, description="bodies are kept apart by this")
    horizon_sides: Positive = Field(8.0, description="robots hear of gaps up to this")
    lifetime_s: Positive = Field(2.0, description="what was heard of a body is forgotten after this")
