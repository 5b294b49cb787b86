"""The dashboard's keys: a stop is never lost among others."""

import os
import pty
import sys
import tty

import pytest

from skyherd.live.session import _keys


@pytest.fixture
def keyboard(monkeypatch):
    """A terminal as standard input: the end that a person types at."""
    person, terminal = pty.openpty()
    tty.setcbreak(terminal)
    with os.fdopen(terminal) as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        yield person
    os.close(person)


def test_the_space_bar_counts_wherever_it_is_among_keys(keyboard):
    with _keys() as key:
        assert key() == ""
        for typed, meant in (
            (b" ", " "),
            (b"xx a", " "),
            (b"qqqq ", " "),
            (b" aa", " "),
            (b"qa", "a"),
            (b"aq", "q"),
        ):
            os.write(keyboard, typed)
            assert key() == meant, typed
            assert key() == "", "all that was typed was read"
