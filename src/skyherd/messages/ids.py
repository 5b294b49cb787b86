"""Ids of robots, units and markers: special values, membership and row search."""

from collections.abc import Set as AbstractSet

import numpy as np
import numpy.typing as npt

from skyherd.errors import MessageError
from skyherd.geometry import BoolArray, IntArray
from skyherd.messages.checks import shown

NO_ID = -1
"""Placeholder for no unit and no robot. Chosen: ids of markers and units are never negative."""


BORDER_IDS: IntArray = np.array([-5, -4, -3, -2])
"""Body ids of the upper, right, lower and left side of the sender's image in a message. Chosen: different
from any unit, robot or marker, and ascending."""


ANONYMOUS_ID = -6
"""Body id of a body without identity: a marker with an unknown or an ambiguous id. Chosen: below
`BORDER_IDS`. A message may contain several of them for one robot."""


def among(ids: IntArray, members: AbstractSet[int] | npt.ArrayLike) -> BoolArray:
    """Return the mask of the `ids` that are in `members`; ids and mask have the same shape.

    For the few robots of one image a Python set is faster than sorting arrays, as `numpy.isin` does.
    """
    wanted = members if isinstance(members, AbstractSet) else set(np.asarray(members).tolist())
    if not wanted:
        return np.zeros(ids.shape, dtype=bool)
    return np.array([robot in wanted for robot in ids.ravel().tolist()], dtype=bool).reshape(ids.shape)


def find_rows(ids: IntArray, wanted: IntArray) -> tuple[IntArray, BoolArray]:
    """Return rows (M,) of the `wanted` ids (M,) in ascending `ids` (N,), and a mask (M,) of those found.

    The search runs over all ids except the last. An id larger than all others then gets the last row, N - 1,
    and not row N, which does not exist. Every row, also of an absent id, is therefore a valid index unless
    `ids` is empty. One comparison finds the absent ids.
    """
    rows = np.asarray(ids[:-1].searchsorted(wanted), dtype=np.int64)
    return rows, np.asarray(ids[rows] == wanted) if ids.size else np.zeros(wanted.shape, dtype=bool)


def rows_of(ids: IntArray, wanted: npt.ArrayLike) -> IntArray:
    """Return rows (M,) of the `wanted` ids (M,), or one row of one id, in ascending `ids` (N,).

    Raises:
        MessageError: a wanted id is not among the `ids`.
    """
    wanted = np.asarray(wanted, dtype=np.int64)
    rows, found = find_rows(ids, wanted)
    if not found.all():
        raise MessageError("ids", f"{shown(wanted[~found].tolist())} are missing", f"one of {ids.tolist()}")
    return rows
