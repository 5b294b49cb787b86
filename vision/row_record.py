"""Records of arrays that run over the same things: some of them, or two after one another."""

from dataclasses import fields
from typing import Any, Self

import numpy as np

from skyherd.geometry import BoolArray, IntArray


class Rows:
    """A dataclass whose every field is an array, or again `Rows`, with one row for each thing."""

    def take(self, rows: IntArray | BoolArray) -> Self:
        """Some of them."""
        if rows.dtype == bool and rows.all():
            return self
        return type(self)(*(_taken(value, rows) for value in _values(self)))

    def put(self, rows: IntArray, others: Self) -> Self:
        """With those at `rows` as in `others`, which has as many."""
        return type(self)(
            *(_put(mine, rows, new) for mine, new in zip(_values(self), _values(others), strict=True))
        )

    def joined(self, others: Self) -> Self:
        """These, then those."""
        return type(self)(*map(_joined, _values(self), _values(others)))


def _values(record: Any) -> list[Any]:
    return [getattr(record, field.name) for field in fields(record)]


def _taken(value: Any, rows: IntArray | BoolArray) -> Any:
    return value.take(rows) if isinstance(value, Rows) else value[rows]


def _put(value: Any, rows: IntArray, others: Any) -> Any:
    if isinstance(value, Rows):
        return value.put(rows, others)
    changed = value.copy()
    changed[rows] = others
    return changed


def _joined(one: Any, other: Any) -> Any:
    return one.joined(other) if isinstance(one, Rows) else np.concatenate([one, other])
