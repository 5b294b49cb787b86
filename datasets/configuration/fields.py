"""Types of values in scenario files, with their ranges."""

import re
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, WithJsonSchema

from skyherd.errors import InputError
from skyherd.markers.dictionary import canonical_name, load_dictionary

MAX_MAGNITUDE = 1e6
"""Maximum magnitude of a quantity, in any unit. Chosen: beyond any real scene (1000 km, 11 days). It rejects
misplaced decimal points, and squares do not overflow."""

MIN_MAGNITUDE = 1e-9
"""Minimum magnitude of a nonzero quantity, in any unit. Chosen: a nanometre or a nanosecond. Quotients stay
finite, and misplaced decimal points are rejected."""

MAX_ROBOTS = 10_000
"""Maximum number of robots, and of items that belong to one robot each. Chosen: ten times the largest number
in `benchmarks/scale.py`."""


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
"""Pattern of the names of scenarios and their output folders, in the syntax of JSON schemas."""


def _check_name(name: str) -> str:
    if not re.fullmatch(NAME_PATTERN, name):
        allowed = "1 to 100 letters, digits, spaces, _ . and -; the first is a letter, a digit or _"
        raise InputError("", "", allowed)
    return name


Name = Annotated[
    str, AfterValidator(_check_name), WithJsonSchema({"type": "string", "pattern": NAME_PATTERN})
]
"""Name that is valid as a folder name."""

DictionaryName = Annotated[str, AfterValidator(_check_dictionary)]
"""Name of a marker dictionary, skyherd's or OpenCV's; the value is skyherd's name."""

Positive = Annotated[FiniteFloat, Field(ge=MIN_MAGNITUDE, le=MAX_MAGNITUDE)]
"""Positive quantity."""

NotNegative = Annotated[FiniteFloat, Field(ge=0, le=MAX_MAGNITUDE), AfterValidator(_zero_or_more)]
"""Quantity that is zero or positive."""

Offset = Annotated[FiniteFloat, Field(ge=-MAX_MAGNITUDE, le=MAX_MAGNITUDE), AfterValidator(_zero_or_more)]
"""Quantity of either sign, or 0."""

Angle = Annotated[FiniteFloat, Field(ge=-3600, le=3600)]
"""Angle, deg. The range is chosen: ten turns."""

Tilt = Annotated[FiniteFloat, Field(ge=-45, le=45)]
"""Tilt of a camera about one of its axes, deg. The range is chosen: the horizon stays out of most images."""

TurnRate = Annotated[FiniteFloat, Field(ge=-3600, le=3600)]
"""Turn rate, deg/s. The range is chosen: ten turns a second, faster than any aircraft with a camera."""

Height = Annotated[FiniteFloat, Field(ge=0.01, le=100_000)]
"""Height above the ground, m. The range is chosen: from a centimetre to beyond any aircraft."""

FrameRate = Annotated[FiniteFloat, Field(ge=0.001, le=10_000)]
"""Images per second, Hz. The range is chosen: from one per 1000 s to high-speed cameras."""

Zoom = Annotated[FiniteFloat, Field(ge=0.01, le=100)]
"""Factor on the focal length. The range is chosen: beyond any lens."""

Seed = Annotated[int, Field(ge=0, lt=2**63)]
"""Seed of random draws: a whole number of at most 63 bits, which TOML and JSON can represent."""

Fraction = Annotated[FiniteFloat, Field(ge=0, lt=1)]
"""Fraction in [0, 1)."""

Share = Annotated[FiniteFloat, Field(ge=0, le=1)]
"""Fraction in [0, 1]."""

Coordinate = Annotated[FiniteFloat, Field(ge=-MAX_MAGNITUDE, le=MAX_MAGNITUDE)]
"""Coordinate of either sign."""

Point = tuple[Coordinate, Coordinate]
"""Two coordinates, (x, y) on the ground or (u, v) in an image."""


class Model(BaseModel):
    """Base of all models of scenario and data set files.

    Unknown keys are errors. Values are immutable after validation.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


ClockOffset = Annotated[FiniteFloat, Field(ge=-86400, le=86400)]
"""Reading of a clock at time 0, s. Chosen: one day."""

ClockDrift = Annotated[FiniteFloat, Field(ge=-1000, le=1000)]
"""Rate error of a clock, ppm; positive if it is fast. Chosen: twenty times that of quartz crystals."""
