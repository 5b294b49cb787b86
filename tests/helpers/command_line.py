"""Calls of the command line in this process, and checks of refusals."""

import pytest

from skyherd.cli import main


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
