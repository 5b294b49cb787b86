"""What is refused before a lab starts, and the dashboard's keys: a stop is never lost among others."""

import os
import pty
import sys
import tty

import pytest
from command_line import call

from skyherd.live.session import _keys


@pytest.mark.parametrize("verb", ["unit", "robot"])
@pytest.mark.parametrize("offset", ["nan", "inf", "1e300", "-86401"])
def test_a_clock_that_is_off_is_off_by_a_number_of_seconds(capsys, tmp_path, verb, offset) -> None:
    code, out, err = call(capsys, verb, "webcams", 0, "--out", tmp_path / "run", "--clock-offset", offset)
    assert code == 2 and not out and len(err.splitlines()) == 1
    assert f"--clock-offset: {float(offset):g}; a number of seconds, 86400 at most either way" in err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("option", "value", "complaint"),
    [
        ("--cameras", ",", "--cameras: address 1 is empty; 2 with commas between"),
        ("--cameras", "", "--cameras: address 1 is empty; "),
        ("--cameras", "a.mp4, ", "--cameras: address 2 is empty; "),
        ("--cameras", "a.mp4", "--cameras: 1 addresses; 2, as in the lab"),
        ("--duration", "nan", "--duration: nan; a number of seconds above 0"),
        ("--duration", "inf", "--duration: inf; a number of seconds above 0"),
        ("--duration", "0", "--duration: 0; a number of seconds above 0"),
        ("--duration", "-5", "--duration: -5; a number of seconds above 0"),
    ],
)
def test_options_of_a_run_that_mean_nothing_are_refused_first(
    capsys, tmp_path, monkeypatch, option, value, complaint
) -> None:
    monkeypatch.setattr("skyherd.live.session.ZenohRadio", None)
    code, out, err = call(capsys, "live", "run", "webcams", "--out", tmp_path / "run", option, value)
    assert code == 2 and not out and len(err.splitlines()) == 1 and complaint in err
    assert not (tmp_path / "run").exists()


def test_an_empty_address_does_not_stand_for_the_lab_s_camera(capsys, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("skyherd.live.zenoh_radio.ZenohRadio", None)
    code, out, err = call(capsys, "unit", "webcams", 0, "--out", tmp_path / "run", "--camera", "")
    assert code == 2 and not out and "--camera: is empty; an address, or leave the option out" in err


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
