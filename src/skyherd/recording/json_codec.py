"""Messages to JSON and back: dataclasses become objects, arrays become lists."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np
import orjson

T = TypeVar("T")

# By itself the encoder writes all attributes of a dataclass, those too that are no fields.
OPTIONS = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS | orjson.OPT_PASSTHROUGH_DATACLASS
"""How orjson writes: NumPy arrays as lists, keys that are no strings as strings, dataclasses by `_plain`."""

_TYPES = {int: "integer", float: "number", bool: "boolean", str: "string"}
_ACCEPTED: dict[type, tuple[type, ...]] = {int: (int,), float: (float, int), bool: (bool,), str: (str,)}


def to_json(value: Any) -> bytes:
    """A value as JSON: dataclasses as objects, arrays as lists, NaN (which JSON does not have) as null.

    Raises:
        orjson.JSONEncodeError: it holds something that is none of this.
    """
    return orjson.dumps(value, default=_plain, option=OPTIONS)


def _plain(value: Any) -> Any:
    """What orjson does not write itself: dataclasses, arrays that are not contiguous, other mappings."""
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} has no place in a message")


def from_plain(kind: type[T], record: Mapping[str, Any], **made: Any) -> T:
    """A dataclass from its JSON object, lists as arrays, and in arrays null as NaN.

    Args:
        kind: the dataclass. Fields that the record lacks have their default.
        record: the object as orjson returns it: dict, list, str, int, float, bool, None.
        **made: fields that are given here as they are, such as nested dataclasses.

    Raises:
        TypeError: the record lacks a field without a default, or one that is declared as `int`, `float`,
            `bool` or `str` is of another type.
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
    """JSON schema of a dataclass; fields that are no int, float, bool or str may have any type."""
    properties = {
        field.name: {"type": _TYPES[field.type]} if field.type in _TYPES else {} for field in fields(kind)
    }
    return {"type": "object", "title": kind.__name__, "properties": properties}
