"""Rows of ids: the search behind every array over robots."""

import numpy as np
import pytest

from skyherd.errors import MessageError
from skyherd.messages import among, find_rows, rows_of

IDS = np.array([2, 5, 9])


def test_rows_of_returns_positions_of_ids() -> None:
    assert rows_of(IDS, [9, 2, 9, 5]).tolist() == [2, 0, 2, 1]
    assert int(rows_of(IDS, 5)) == 1
    assert rows_of(IDS, []).tolist() == rows_of(IDS[:0], []).tolist() == []


def test_find_rows_of_any_shape_marks_absent_ids() -> None:
    """The reference is a linear search; the rows of absent ids are valid indices as well."""
    wanted = np.array([[9, 1, 5], [3, 10, 2]])
    rows, found = find_rows(IDS, wanted)
    assert found.tolist() == [[wish in IDS.tolist() for wish in line] for line in wanted.tolist()]
    assert IDS[rows[found]].tolist() == wanted[found].tolist()
    assert ((rows >= 0) & (rows < IDS.size)).all()
    assert not find_rows(IDS[:0], wanted)[1].any()


@pytest.mark.parametrize("shape", [(0,), (6,), (3, 2), (0, 2)])
def test_among_equals_numpy_isin(shape: tuple[int, ...]) -> None:
    ids = np.random.default_rng(3).integers(0, 12, shape)
    for members in ([], [9], IDS.tolist()):
        for given in (members, frozenset(members), np.array(members, dtype=np.int64)):
            np.testing.assert_array_equal(among(ids, given), np.isin(ids, members), strict=True)


@pytest.mark.parametrize("absent", [1, 3, 7, 10])
def test_rows_of_rejects_absent_ids(absent: int) -> None:
    with pytest.raises(MessageError, match=rf"\[{absent}\]"):
        rows_of(IDS, [5, absent])
    with pytest.raises(MessageError, match=str(absent)):
        rows_of(IDS, absent)
    with pytest.raises(MessageError):
        rows_of(IDS[:0], [absent])
