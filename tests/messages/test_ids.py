"""Rows of ids: the search that every array over robots rests on."""

import numpy as np
import pytest

from skyherd.errors import MessageError
from skyherd.messages import rows_of

IDS = np.array([2, 5, 9])


def test_rows_are_where_the_ids_are() -> None:
    assert rows_of(IDS, [9, 2, 9, 5]).tolist() == [2, 0, 2, 1]
    assert int(rows_of(IDS, 5)) == 1
    assert rows_of(IDS, []).tolist() == rows_of(IDS[:0], []).tolist() == []


@pytest.mark.parametrize("absent", [1, 3, 7, 10])
def test_an_absent_id_is_refused_wherever_it_would_lie(absent: int) -> None:
    with pytest.raises(MessageError, match=rf"\[{absent}\]"):
        rows_of(IDS, [5, absent])
    with pytest.raises(MessageError, match=str(absent)):
        rows_of(IDS, absent)
    with pytest.raises(MessageError):
        rows_of(IDS[:0], [absent])
