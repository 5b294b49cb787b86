"""Messages as plain values, for JSON: dataclasses and arrays to objects and lists, and back."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np
import orjson

T = TypeVar("T")

# By itself the encoder writes all attributes of a dataclass, those too that are no fields.
OPTIONS = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS | orjson.OPT_PASSTHROUGH_DATACLASS
_TYPES = {int: "integer", float: "number", bool: "boolean", str: "string"}


def to_json(value: Any) -> bytes:
    """A value as JSON: dataclasses as objects, arrays as lists; NaN, which JSON lacks, as null."""
    return orjson.dumps(value, default=_plain, option=OPTIONS)


def _plain(value: Any) -> Any:
    """What is left to us: the fields of dataclasses, arrays not in one piece, mappings that are no dict."""
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} has no place in a message")


def from_plain(kind: type[T], record: Mapping[str, Any], **made: Any) -> T:
    """A dataclass from what is read back of it; `made` holds fields to take as they are."""
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
