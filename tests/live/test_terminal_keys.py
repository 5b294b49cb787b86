"""Keys of a run: no stop is lost, nothing arms by chance, and Ctrl-Z does not suspend what moves robots."""

import os
import pty
import select
import signal
import sys
import termios
import time
from collections import deque
from types import SimpleNamespace

import pytest

from skyherd.live.terminal_keys import MAX_KEYS, SUSPEND, _windows_key, terminal_keys

TYPED = [
    ("", ""),
    ("q", "q"),
    ("a", "a"),
    ("aaa", "a"),
    (" ", " "),
    ("xx a", " "),
    ("qqqq ", " "),
    ("\x1b[1 a", " "),
    ("qa", ""),
    ("abq", ""),
    ("\x1b[a", ""),
    ("pasted text".replace(" ", "") + "a", ""),
]
"""Typed at once, and the key that counts: an escape sequence or pasted text arms nothing."""


@pytest.mark.parametrize(("typed", "key"), TYPED)
def test_windows_console_has_the_same_keys(monkeypatch, typed, key) -> None:
    waiting = deque(typed)
    console = SimpleNamespace(kbhit=lambda: bool(waiting), getwch=waiting.popleft)
    monkeypatch.setitem(sys.modules, "msvcrt", console)
    assert _windows_key() == key and not waiting


def test_windows_console_limits_keys_read_at_once(monkeypatch) -> None:
    waiting = deque("q" * (2 * MAX_KEYS))
    console = SimpleNamespace(kbhit=lambda: bool(waiting), getwch=waiting.popleft)
    monkeypatch.setitem(sys.modules, "msvcrt", console)
    assert _windows_key() == "q" and len(waiting) == MAX_KEYS


@pytest.fixture
def keyboard(monkeypatch):
    """Yield the typing end of a pseudo terminal that replaces the standard input."""
    person, terminal = pty.openpty()
    with os.fdopen(terminal) as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        yield person
    os.close(person)


def test_space_bar_has_priority_among_keys(keyboard) -> None:
    with terminal_keys() as key:
        assert key() == ""
        for typed, meant in TYPED:
            os.write(keyboard, typed.encode())
            assert key() == meant, typed
            began_s = time.monotonic()
            assert key() == "", "all that was typed was read"
            assert time.monotonic() - began_s < 0.9, "nothing waits for a key"


def test_terminal_gets_its_mode_back(keyboard) -> None:
    before = termios.tcgetattr(sys.stdin)
    with terminal_keys():
        assert not termios.tcgetattr(sys.stdin)[3] & termios.ICANON
    assert termios.tcgetattr(sys.stdin) == before


def test_keys_need_no_enter_after_a_shell_set_the_mode(keyboard) -> None:
    with terminal_keys() as key:
        mode = termios.tcgetattr(sys.stdin)
        mode[3] |= termios.ICANON
        termios.tcsetattr(sys.stdin, termios.TCSANOW, mode)
        assert key() == ""
        os.write(keyboard, b" ")
        assert key() == " "


SCRIPT = """
import time
from skyherd.live.terminal_keys import terminal_keys
with terminal_keys() as key:
    print("ready", flush=True)
    while True:
        if pressed := key():
            print("key:", repr(pressed), flush=True)
        time.sleep(0.01)
"""


@pytest.fixture
def process():
    """Yield the number of a process that prints its keys, and the typing end of its own terminal."""
    number, person = pty.fork()
    if not number:  # pragma: no cover
        os.execv(sys.executable, [sys.executable, "-c", SCRIPT])
    try:
        read_until(person, "ready")
        yield number, person
    finally:
        os.kill(number, signal.SIGKILL)
        os.waitpid(number, 0)
        os.close(person)


def read_until(person: int, words: str) -> None:
    said, limit_s = "", time.monotonic() + 20
    while words not in said and (left_s := limit_s - time.monotonic()) > 0:
        if select.select([person], [], [], left_s)[0]:
            said += os.read(person, 4096).decode()
    assert words in said


def test_suspend_key_of_a_terminal_is_a_key(process) -> None:
    """A process that Ctrl-Z stops prints nothing more."""
    number, person = process
    os.write(person, b"\x1a")
    read_until(person, repr(SUSPEND))
    os.write(person, b" ")
    read_until(person, "' '")
    assert os.waitpid(number, os.WNOHANG | os.WUNTRACED) == (0, 0), "neither stopped nor ended"


SHELL = f"""
import os, signal, subprocess, sys, termios, time
signal.signal(signal.SIGTTOU, signal.SIG_IGN)
def restore():
    signal.signal(signal.SIGTTOU, signal.SIG_DFL)
job = subprocess.Popen([sys.executable, "-c", {SCRIPT!r}], process_group=0, preexec_fn=restore)
sys.stdin.readline()
stopped = os.waitpid(job.pid, os.WNOHANG | os.WUNTRACED)
canonical = bool(termios.tcgetattr(0)[3] & termios.ICANON)
print("job:", stopped, canonical, flush=True)
os.tcsetpgrp(0, job.pid)
time.sleep(60)
"""


def test_process_in_the_background_leaves_the_terminal() -> None:
    """It is not suspended, and lets the shell its mode; keys count once it is in the foreground."""
    shell, person = pty.fork()
    if not shell:  # pragma: no cover
        os.execv(sys.executable, [sys.executable, "-c", SHELL])
    try:
        read_until(person, "ready")
        os.write(person, b"line for the shell\n")
        read_until(person, "job: (0, 0) True")
        os.write(person, b" ")
        read_until(person, "key: ' '")
    finally:
        os.killpg(os.tcgetpgrp(person), signal.SIGKILL)
        os.kill(shell, signal.SIGKILL)
        os.waitpid(shell, 0)
        os.close(person)
