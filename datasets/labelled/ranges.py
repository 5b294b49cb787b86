"""Ranges from which values are drawn: `[least, greatest]` in TOML, or one number if nothing varies."""

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
    except ValidationError as error:  # of both ends; one problem, of the number, is reported
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
    """Tells the JSON schema that one number will do."""

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        pair = handler(core)
        return {"anyOf": [pair["prefixItems"][0], pair]}


Span = Annotated[tuple[T, T], WrapValidator(_pair), AfterValidator(_ordered), _OneOrTwo()]
"""A range of values of a type: a pair in ascending order; one number is taken as both."""

BELOW_NEXT = 1e-9
"""By how much a draw of whole numbers ends below the number after the last. *Chosen*: keeps the rounding of
the product from reaching that number; it changes the odds by as little."""


def draw_number(rng: np.random.Generator, span: tuple[float, float]) -> float:
    """Draw a number uniformly from a range.

    One random number is used even where the ends are equal, so that a range that is narrowed to one value
    does not change the values drawn after it.
    """
    check_kind("draw_number: rng", rng, np.random.Generator, "a numpy.random.Generator")
    return float(rng.uniform(0.0, 1.0) * (span[1] - span[0]) + span[0])


def draw_integer(rng: np.random.Generator, span: tuple[int, int]) -> int:
    """Draw a whole number from the first to the last of a range, each as likely."""
    return int(np.floor(draw_number(rng, (span[0], span[1] + 1 - BELOW_NEXT))))
