"""Representation of values with arrays on one line: shapes instead of numbers."""

from collections.abc import Sized
from dataclasses import fields
from enum import Enum
from typing import Any

import numpy as np

from skyherd.text import shorten

MAX_NUMBERS = 4
"""Size of the largest array whose numbers are shown. Chosen: a point, a size, or a quadrilateral's sides."""

MAX_CHARACTERS = 40
"""Most characters of a text that are shown. Chosen: a name or a short path."""


def short_repr(owner: Any) -> str:
    """Return the fields of a dataclass on one line; assign it to `__repr__` in the class's body.

    A large array is shown by its shape, a collection by its length, and another dataclass by its name.
    """
    shown = ", ".join(f"{field.name}={short_value(getattr(owner, field.name))}" for field in fields(owner))
    return f"{type(owner).__name__}({shown})"


def short_value(value: object) -> str:
    """Return a value as `short_repr` shows it."""
    if isinstance(value, Enum):
        return value.name
    if value is None or isinstance(value, bool | int | np.bool_):
        return str(value)
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if isinstance(value, str):
        return repr(shorten(value, MAX_CHARACTERS))
    if isinstance(value, np.ndarray):
        if value.ndim == 1 and value.size <= MAX_NUMBERS:
            return f"[{', '.join(short_value(number) for number in value.tolist())}]"
        return f"{'x'.join(map(str, value.shape))} array"
    if isinstance(value, Sized):
        return f"{type(value).__name__} of {len(value)}"
    return f"{type(value).__name__}(…)"
