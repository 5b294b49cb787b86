"""Messages as plain values, for JSON: dataclasses and arrays to objects and lists, and back."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

_TYPES = {int: "integer", float: "number", bool: "boolean", str: "string"}


def to_plain(value: Any) -> Any:
    """A value as JSON has it; NaN, which JSON lacks, becomes null."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind == "f" and np.isnan(value).any():
            return [to_plain(item) for item in value]
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if is_dataclass(value):
        return {field.name: to_plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and np.isnan(value) else value


def from_plain(kind: type[T], record: Mapping[str, Any], **made: Any) -> T:
    """A dataclass from what `to_plain` made of it; `made` holds fields to take as they are."""
    values = {}
    for field in fields(kind):  # type: ignore[arg-type]
        if field.name not in made and field.name not in record:
            continue
        value = made.get(field.name, record.get(field.name))
        if isinstance(value, list):
            value = _array(value)
        values[field.name] = value
    return kind(**values)


def _array(value: list[Any]) -> np.ndarray:
    array = np.array(value)
    return array.astype(float) if array.dtype == object else array


def json_schema(kind: type) -> dict[str, Any]:
    """JSON schema of a dataclass of scalars and arrays."""
    properties = {
        field.name: {"type": _TYPES[field.type]} if field.type in _TYPES else {} for field in fields(kind)
    }
    return {"type": "object", "title": kind.__name__, "properties": properties}
