"""Robot and marker ids: who is meant by none, which of them are members, and in which row each is found."""

from collections.abc import Set as AbstractSet

import numpy as np
import numpy.typing as npt

from skyherd.errors import MessageError
from skyherd.geometry import BoolArray, IntArray

NO_ID = -1
"""Stands for no unit and no robot. Chosen: ids of markers and units are never negative."""


BORDER_IDS: IntArray = np.array([-5, -4, -3, -2])
"""Stand for the upper, right, lower and left side of the sender's image, where a message names bodies.
Chosen: like no unit, robot or marker, and ascending."""


def among(ids: IntArray, members: AbstractSet[int] | npt.ArrayLike) -> BoolArray:
    """Mask of the `ids` that are in `members`; ids and mask have any one shape.

    For the few robots of one image a Python set is faster than sorting arrays, as `numpy.isin` does.
    """
    wanted = members if isinstance(members, AbstractSet) else set(np.asarray(members).tolist())
    return np.array([robot in wanted for robot in ids.ravel().tolist()], dtype=bool).reshape(ids.shape)


def find_rows(ids: IntArray, wanted: IntArray) -> tuple[IntArray, BoolArray]:
    """Rows (M,) of the `wanted` ids (M,) in `ids` (N,), which must ascend, and a mask (M,) of those found.

    The search runs over all ids but the last. An id that is larger than all others then gets the last row,
    N - 1, and not row N, which does not exist; so every row, of an absent id too, may be used as an index
    unless `ids` are none, and one comparison finds the ids that are absent.
    """
    rows = np.asarray(ids[:-1].searchsorted(wanted), dtype=np.int64)
    return rows, np.asarray(ids[rows] == wanted) if ids.size else np.zeros(wanted.shape, dtype=bool)


def rows_of(ids: IntArray, wanted: npt.ArrayLike) -> IntArray:
    """Rows (M,) of the `wanted` ids (M,), or one row for one id, in `ids` (N,), which must ascend.

    Raises:
        MessageError: a wanted id is not among the `ids`.
    """
    wanted = np.asarray(wanted, dtype=np.int64)
    rows, found = find_rows(ids, wanted)
    if not found.all():
        raise MessageError(f"ids {wanted[~found].tolist()} are not among {ids.tolist()}")
    return rows
