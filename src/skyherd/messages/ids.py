"""Robot and marker ids: who is meant by none, which of them are members, and in which row each is found."""

from collections.abc import Set as AbstractSet

import numpy as np
import numpy.typing as npt

from skyherd.errors import MessageError
from skyherd.geometry import BoolArray, IntArray

NO_ID = -1
"""Stands for no unit and no robot. Chosen: ids of markers and units are never negative."""


def among(ids: IntArray, members: AbstractSet[int] | npt.ArrayLike) -> BoolArray:
    """(N,) mask of the `ids` (N,) that are in `members`.

    For the few robots of one image a Python set is faster than sorting arrays, as `numpy.isin` does.
    """
    wanted = members if isinstance(members, AbstractSet) else set(np.asarray(members).tolist())
    return np.array([robot in wanted for robot in ids.tolist()], dtype=bool)


def rows_of(ids: IntArray, wanted: npt.ArrayLike) -> IntArray:
    """Rows (M,) of the `wanted` ids (M,), or one row for one id, in `ids` (N,), which must ascend.

    The search runs over all ids but the last. An id that is larger than all others then gets the last row,
    N - 1, and not row N, which does not exist; so every result may be used as an index, and one comparison
    finds the ids that are absent.

    Raises:
        MessageError: a wanted id is not among the `ids`.
    """
    wanted = np.asarray(wanted, dtype=np.int64)
    rows = np.searchsorted(ids[:-1], wanted)
    absent = ids[rows] != wanted if ids.size else np.ones(wanted.shape, dtype=bool)
    if absent.any():
        raise MessageError(f"ids {wanted[absent].tolist()} are not among {ids.tolist()}")
    return np.asarray(rows, dtype=np.int64)
