"""Kinds of values that scenario files hold, with their ranges."""

import re
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, WithJsonSchema

from skyherd.errors import InputError
from skyherd.markers.dictionary import canonical_name, load_dictionary

MAX_MAGNITUDE = 1e6
"""Largest magnitude of a quantity in any unit. *Chosen*: beyond any real scene (1000 km, 11 days), so that a
slip of the decimal point is refused, and no square of it overflows."""

MIN_MAGNITUDE = 1e-9
"""Least magnitude of a quantity that is not 0, in any unit. *Chosen*: a nanometre and a nanosecond; what is
divided by it stays finite, and a slip of the decimal point is refused."""

MAX_ROBOTS = 10_000
"""Greatest number of robots, and of points and other things that there are for each. *Chosen*: ten times what
`benchmarks/scale.py` runs."""


def _zero_or_more(value: float) -> float:
    if 0 < abs(value) < MIN_MAGNITUDE:
        raise InputError("", f"{value!r}", f"0, or at least {MIN_MAGNITUDE:g} either side of it")
    return value


def _check_dictionary(name: str) -> str:
    try:
        load_dictionary(name)
    except InputError as error:
        raise InputError("", error.what, error.allowed) from None
    return canonical_name(name)


NAME_PATTERN = r"^\w[\w .-]{0,99}$"
"""Names of scenarios, which are those of output folders too, as JSON schemas write it."""


def _check_name(name: str) -> str:
    if not re.fullmatch(NAME_PATTERN, name):
        allowed = "1 to 100 letters, digits, spaces, _ . and -; the first is a letter, a digit or _"
        raise InputError("", "", allowed)
    return name


Name = Annotated[
    str, AfterValidator(_check_name), WithJsonSchema({"type": "string", "pattern": NAME_PATTERN})
]
"""A name that a folder can have."""

DictionaryName = Annotated[str, AfterValidator(_check_dictionary)]
"""Name of a marker dictionary, skyherd's or OpenCV's; the value is skyherd's name."""

Positive = Annotated[FiniteFloat, Field(ge=MIN_MAGNITUDE, le=MAX_MAGNITUDE)]
"""A quantity above 0."""

NotNegative = Annotated[FiniteFloat, Field(ge=0, le=MAX_MAGNITUDE), AfterValidator(_zero_or_more)]
"""A quantity of 0 or more."""

Offset = Annotated[FiniteFloat, Field(ge=-MAX_MAGNITUDE, le=MAX_MAGNITUDE), AfterValidator(_zero_or_more)]
"""A quantity of either sign, or 0."""

Angle = Annotated[FiniteFloat, Field(ge=-3600, le=3600)]
"""An angle, deg. The range is *chosen*: ten turns; beyond it, it is hardly an angle."""

TurnRate = Annotated[FiniteFloat, Field(ge=-3600, le=3600)]
"""A turn rate, deg/s. The range is *chosen*: ten turns a second, faster than anything that flies a camera."""

Height = Annotated[FiniteFloat, Field(ge=0.01, le=100_000)]
"""A height above the ground, m. The range is *chosen*: from a centimetre to beyond any aircraft."""

FrameRate = Annotated[FiniteFloat, Field(ge=0.001, le=10_000)]
"""Images a second, Hz. The range is *chosen*: from one in a quarter of an hour to high-speed cameras."""

Zoom = Annotated[FiniteFloat, Field(ge=0.01, le=100)]
"""A factor on the focal length. The range is *chosen*: beyond any lens."""

Seed = Annotated[int, Field(ge=0, lt=2**63)]
"""A seed of random draws: a whole number of at most 63 bits, which TOML and JSON hold."""

Fraction = Annotated[FiniteFloat, Field(ge=0, lt=1)]
"""A share that is never the whole: 0 up to, but not, 1."""

Share = Annotated[FiniteFloat, Field(ge=0, le=1)]
"""A share from 0 to 1, both allowed."""

Coordinate = Annotated[FiniteFloat, Field(ge=-MAX_MAGNITUDE, le=MAX_MAGNITUDE)]
"""A coordinate of either sign."""

Point = tuple[Coordinate, Coordinate]
"""Two coordinates, (x, y) on the ground or (u, v) in an image."""


class Model(BaseModel):
    """Base of all models of scenario and data set files.

    Unknown keys are errors, and values do not change after they were checked.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


ClockOffset = Annotated[FiniteFloat, Field(ge=-86400, le=86400)]
"""What a clock shows when it should show 0, s. *Chosen*: a day."""

ClockDrift = Annotated[FiniteFloat, Field(ge=-1000, le=1000)]
"""By how many millionths a clock is fast. *Chosen*: twenty times what quartz crystals are off."""
