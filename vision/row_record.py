"""Structure of arrays: dataclasses whose fields have one row per element, with operations on whole rows."""

from typing import Any, Self

import numpy as np

from skyherd.geometry import BoolArray, IntArray


class RowRecord:
    """Base class of dataclasses in which every field has N rows.

    A field is an array whose first axis has length N, or another `RowRecord` of N rows. The operations below
    select, replace and append the same rows in all fields, so that the fields stay consistent.
    """

    def take(self, rows: IntArray | BoolArray) -> Self:
        """Return the record of the given rows: indices (K,), in their order, or a mask (N,).

        If the mask selects every row, the result is the record itself, not a copy.
        """
        if rows.dtype == bool and rows.all():
            return self
        indices = np.flatnonzero(rows) if rows.dtype == bool else np.asarray(rows, dtype=np.int64)
        return type(self)(*(_taken(value, indices) for value in _values(self)))

    def put(self, rows: IntArray, others: Self) -> Self:
        """Return a copy in which the K rows of `others` replace the rows at indices `rows` (K,)."""
        return type(self)(
            *(_put(mine, rows, new) for mine, new in zip(_values(self), _values(others), strict=True))
        )

    def joined(self, others: Self) -> Self:
        """Return a record with the rows of this record, followed by the rows of `others`."""
        return type(self)(*map(_joined, _values(self), _values(others)))


def _values(record: Any) -> list[Any]:
    return [getattr(record, name) for name in record.__dataclass_fields__]  # `fields` takes twice as long


def _taken(value: Any, rows: IntArray) -> Any:
    return value.take(rows) if isinstance(value, RowRecord) else value.take(rows, axis=0)


def _put(value: Any, rows: IntArray, others: Any) -> Any:
    if isinstance(value, RowRecord):
        return value.put(rows, others)
    changed = value.copy()
    changed[rows] = others
    return changed


def _joined(one: Any, other: Any) -> Any:
    return one.joined(other) if isinstance(one, RowRecord) else np.concatenate([one, other])
