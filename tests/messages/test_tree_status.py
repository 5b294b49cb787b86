"""Tree status of a unit: lists that belong together are consistent, and ids occur once."""

import pytest

from skyherd.errors import MessageError
from skyherd.messages import NO_SLOT, TreeStatus


def status(**changes):
    """Return a status of two edges, and two robots that are handed over."""
    fields = {
        "tree_id": 0,
        "asks_id": -1,
        "ask_turn": 0,
        "heir_id": 1,
        "ready": True,
        "neighbor_ids": [1, 2],
        "turns": [4, 7],
        "pairs": [[1, 2], [-1, -1]],
        "offered_ids": [5],
        "offered_to_ids": [1],
        "to_release_ids": [5],
        "missing_ids": [6],
        "handed_ids": [7, 8],
        "handed_to_ids": [1, 2],
        "handed_slots": [NO_SLOT, 12],
        "accepted_ids": [9],
    }
    return TreeStatus(**(fields | changes))


def test_tree_status_accepts_consistent_lists() -> None:
    assert status().handed_slots.tolist() == [NO_SLOT, 12]


@pytest.mark.parametrize(
    "changes",
    [
        {"turns": [4]},
        {"pairs": [[1, 2]]},
        {"offered_to_ids": []},
        {"handed_to_ids": [1]},
        {"handed_slots": [12]},
        {"handed_slots": [12, 13, 14]},
        {"handed_slots": [12.5, 13]},
        {"handed_ids": [7, 7]},
        {"accepted_ids": [9, 9]},
    ],
    ids=str,
)
def test_tree_status_rejects_inconsistent_lists(changes) -> None:
    """The lists arrive by radio: an inconsistent one would fail in the middle of a decision."""
    with pytest.raises(MessageError):
        status(**changes)
