"""Keys of a run's terminal, which may be held, sent to the background, or asked to suspend the run."""

import importlib
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

MAX_KEYS = 1024
"""Largest number of keys read at once. Chosen: more than a person presses within a refresh period."""

SUSPEND = "suspend"
"""Key that stands for Ctrl-Z, which a terminal sends as a signal."""


@contextmanager
def terminal_keys() -> Iterator[Callable[[], str]]:
    """Yield a function that returns the key pressed since the last call, or an empty string.

    Of several keys the space bar has priority: no stop is lost. `a` counts only by itself, not at the end of
    pasted text or of an escape sequence. Without a terminal no key is returned.

    A run that is suspended cannot stop its robots. Ctrl-Z is therefore a key like the others (`SUSPEND`),
    and a run in the background neither reads keys nor changes the terminal until it is in the foreground.
    """
    if not sys.stdin.isatty():
        yield lambda: ""
        return
    if sys.platform == "win32":
        yield _windows_key
        return
    with _never_suspended() as suspend_asked, _unbuffered() as keys:

        def pressed() -> str:
            if suspend_asked.is_set():
                suspend_asked.clear()
                return SUSPEND
            return _chosen_key(keys())

        yield pressed


@contextmanager
def _never_suspended() -> Iterator[threading.Event]:
    """Yield an event that Ctrl-Z sets. Nor does the terminal suspend the process in the background."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return

    def ask(number: int, frame: FrameType | None) -> None:
        asked.set()

    before = {
        signal.SIGTSTP: signal.signal(signal.SIGTSTP, ask),
        signal.SIGTTIN: signal.signal(signal.SIGTTIN, signal.SIG_IGN),
        signal.SIGTTOU: signal.signal(signal.SIGTTOU, signal.SIG_IGN),
    }
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _unbuffered() -> Iterator[Callable[[], str]]:
    """Yield a function that returns the keys pressed since the last call, at once and without Enter.

    A shell sets the terminal's mode again when it takes the terminal over, so that it is checked each time.
    """
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before: list[Any] = []

    def prepare() -> bool:
        """Return whether keys are this process's, and have them sent without Enter if so."""
        if not _is_in_foreground(terminal):
            return False
        now = termios.tcgetattr(terminal)
        if now[3] & termios.ICANON:
            before[:] = before or [now]
            tty.setcbreak(terminal, termios.TCSANOW)
        return True

    def keys() -> str:
        if not prepare():
            return ""
        ready, _, _ = select.select([terminal], [], [], 0)
        # os.read bypasses Python's buffer: select would not see keys that the buffer holds.
        return os.read(terminal, MAX_KEYS).decode(errors="replace") if ready else ""

    prepare()
    try:
        yield keys
    finally:
        if before and _is_in_foreground(terminal):
            termios.tcsetattr(terminal, termios.TCSANOW, before[0])


def _is_in_foreground(terminal: int) -> bool:
    """Return whether the keys of a terminal are this process's; True if it is not the controlling one."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return True


def _windows_key() -> str:
    """Return the key pressed at a Windows console since the last call, or an empty string."""
    msvcrt = importlib.import_module("msvcrt")
    keys = ""
    while msvcrt.kbhit() and len(keys) < MAX_KEYS:
        keys += msvcrt.getwch()
    return _chosen_key(keys)


def _chosen_key(keys: str) -> str:
    """Return the space bar if it is among the keys, a key that is pressed alone, or an empty string."""
    if " " in keys:
        return " "
    return keys[0] if keys and set(keys) == {keys[0]} else ""
