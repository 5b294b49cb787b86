"""Ranges from which values are drawn: `[least, greatest]` in TOML, or one number for a constant."""

from dataclasses import dataclass
from typing import Annotated, Any, TypeVar, cast

import numpy as np
from pydantic import (
    AfterValidator,
    GetJsonSchemaHandler,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)
from pydantic_core import CoreSchema, PydanticKnownError

from skyherd.errors import InputError
from skyherd.messages.checks import check_kind

T = TypeVar("T")


def _pair(value: Any, check: ValidatorFunctionWrapHandler) -> Any:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return check(value)
    try:
        return check((value, value))
    except ValidationError as error:  # both ends have it; one problem of the number is reported
        first = error.errors(include_url=False)[0]
        context = dict(first.get("ctx", {}))
        if isinstance(context.get("error"), InputError):
            raise context["error"] from None
        raise PydanticKnownError(cast(Any, first["type"]), context) from None


def _ordered(pair: tuple[Any, Any]) -> tuple[Any, Any]:
    if pair[0] > pair[1]:
        raise InputError("", f"[{pair[0]:g}, {pair[1]:g}]", "a range with the smaller number first")
    return pair


@dataclass(frozen=True)
class _OneOrTwo:
    """Annotation that allows one number in the JSON schema."""

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        pair = handler(core)
        return {"anyOf": [pair["prefixItems"][0], pair]}


Span = Annotated[tuple[T, T], WrapValidator(_pair), AfterValidator(_ordered), _OneOrTwo()]
"""Range of values of a type: a pair in ascending order; one number counts as both ends."""

BELOW_NEXT = 1e-9
"""Distance between the end of the range of `draw_integer` and the next integer. Chosen: rounding of the
product cannot reach that integer, and the odds change by the same small amount."""


def draw_number(rng: np.random.Generator, span: tuple[float, float]) -> float:
    """Draw a number uniformly from a range.

    A constant uses one random number as well. Narrowing a range to one value therefore does not change later
    draws.
    """
    check_kind("draw_number: rng", rng, np.random.Generator, "a numpy.random.Generator")
    return float(rng.uniform(0.0, 1.0) * (span[1] - span[0]) + span[0])


def draw_integer(rng: np.random.Generator, span: tuple[int, int]) -> int:
    """Draw a whole number uniformly from a range, both ends included."""
    return int(np.floor(draw_number(rng, (span[0], span[1] + 1 - BELOW_NEXT))))
