"""Conversion of messages to and from JSON: dataclasses become objects, arrays become lists."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np
import orjson

T = TypeVar("T")

# The encoder would write all attributes of a dataclass, including those that are not fields.
OPTIONS = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS | orjson.OPT_PASSTHROUGH_DATACLASS
"""Options of orjson: NumPy arrays as lists, non-string keys as strings, dataclasses by `_plain`."""

_TYPES = {int: "integer", float: "number", bool: "boolean", str: "string"}
_ACCEPTED: dict[type, tuple[type, ...]] = {int: (int,), float: (float, int), bool: (bool,), str: (str,)}


def to_json(value: Any) -> bytes:
    """Encode a value as JSON: dataclasses as objects, arrays as lists, NaN as null.

    Raises:
        orjson.JSONEncodeError: it holds a value of another type.
    """
    return orjson.dumps(value, default=_plain, option=OPTIONS)


def _plain(value: Any) -> Any:
    """Convert values that orjson does not write: dataclasses, non-contiguous arrays, other mappings."""
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} cannot be stored in a message")


def from_plain(kind: type[T], record: Mapping[str, Any], **made: Any) -> T:
    """Build a dataclass from its JSON object, lists as arrays, and null in arrays as NaN.

    Args:
        kind: the dataclass. Fields missing in the record have their default.
        record: the object as orjson returns it: dict, list, str, int, float, bool, None.
        **made: final values of some fields, such as nested dataclasses.

    Raises:
        TypeError: the record lacks a field without a default, or a field declared as `int`, `float`, `bool`
            or `str` has another type.
    """
    values = {}
    for field in fields(kind):  # type: ignore[arg-type]
        if field.name not in made and field.name not in record:
            continue
        value = made.get(field.name, record.get(field.name))
        if field.type in _ACCEPTED:
            _check_scalar(value, field.type, f"{kind.__name__}.{field.name}")
        elif isinstance(value, list):
            value = _array(value)
        values[field.name] = value
    return kind(**values)


def _check_scalar(value: Any, kind: Any, where: str) -> None:
    is_other_bool = isinstance(value, bool) and kind is not bool
    if is_other_bool or not isinstance(value, _ACCEPTED[kind]):
        raise TypeError(f"{where}: {type(value).__name__}, expected {_TYPES[kind]}")


def _array(value: list[Any]) -> np.ndarray:
    array = np.array(value)
    return array.astype(float) if array.dtype == object else array


def json_schema(kind: type) -> dict[str, Any]:
    """Return the JSON schema of a dataclass; fields other than int, float, bool or str may have any type."""
    properties = {
        field.name: {"type": _TYPES[field.type]} if field.type in _TYPES else {} for field in fields(kind)
    }
    return {"type": "object", "title": kind.__name__, "properties": properties}
