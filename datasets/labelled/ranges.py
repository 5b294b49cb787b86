"""Ranges from which values are drawn: `[least, greatest]`, or one number where nothing varies."""

from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, GetJsonSchemaHandler
from pydantic_core import CoreSchema

T = TypeVar("T")


def _pair(value: Any) -> Any:
    return (value, value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _ordered(pair: tuple[Any, Any]) -> tuple[Any, Any]:
    if pair[0] > pair[1]:
        raise ValueError(f"a range goes from least to greatest, not from {pair[0]:g} to {pair[1]:g}")
    return pair


@dataclass(frozen=True)
class _OneOrTwo:
    """Tells the JSON schema that one number will do."""

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        pair = handler(core)
        return {"anyOf": [pair["prefixItems"][0], pair]}


Span = Annotated[tuple[T, T], BeforeValidator(_pair), AfterValidator(_ordered), _OneOrTwo()]


def draw_number(rng: np.random.Generator, span: tuple[float, float]) -> float:
    """A number between the ends, uniform; drawn also where they are equal, lest streams shift."""
    return float(rng.uniform(0.0, 1.0) * (span[1] - span[0]) + span[0])


def draw_integer(rng: np.random.Generator, span: tuple[int, int]) -> int:
    """A whole number from the first to the last, each as likely."""
    return int(np.floor(draw_number(rng, (span[0], span[1] + 1 - 1e-9))))
