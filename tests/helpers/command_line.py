"""Calls of the command line in this process, and checks of refusals."""

from collections.abc import Iterator
from typing import Any

import pytest
import typer

from skyherd.cli import app, main


def verbs(command: Any = None, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the words and the command of each verb and group of verbs, first of the program itself."""
    command = command or typer.main.get_command(app)
    yield words, command
    for name, below in getattr(command, "commands", {}).items():
        yield from verbs(below, (*words, name))


def call(capsys, *arguments):
    """Return exit code, stdout and stderr of one call."""
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    said = capsys.readouterr()
    return ended.value.code or 0, said.out, said.err


def assert_refused(result, *words):
    """Check for exit code 2, and for one line on stderr that contains the words."""
    code, _, err = result
    assert code == 2
    assert err.count("\n") == 1, err
    assert "Traceback" not in err
    for word in words:
        assert word in err, err
