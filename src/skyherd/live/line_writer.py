"""Lines written by a thread of its own, because a held terminal or a disk that hangs blocks its writer."""

import os
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress

NAME = "writer"
"""Beginning of the names of threads that write."""

CLOSE_S = 2.0
"""Longest wait for waiting lines at the end, s. Chosen: longer than a slow link needs for a dashboard."""


class LineWriter:
    """Writer of lines, one after the other.

    A terminal takes no output after Ctrl-S, during a selection, or over a connection that stalls; a pipe
    takes none while it is full, and a disk none while it hangs. Meanwhile new lines wait. Errors lose a line.

    Args:
        write: writes a line.
        most: number of lines that wait at most; older ones are lost.
    """

    def __init__(self, write: Callable[[str], None], most: int) -> None:
        self._write, self._lines = write, deque[str](maxlen=most)
        self._news, self._closing = threading.Condition(), False
        self._thread = threading.Thread(target=self._run, name=NAME, daemon=True)
        self._thread.start()

    def put(self, line: str) -> None:
        """Write a line soon."""
        with self._news:
            self._lines.append(line)
            self._news.notify()

    def close(self) -> bool:
        """Write the lines that wait. Return False if that is still not possible after `CLOSE_S`."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join(CLOSE_S)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._lines or self._closing)
                if not self._lines:
                    return
                line = self._lines.popleft()
            with suppress(OSError, ValueError):
                self._write(line)


def leave_if_held(code: int) -> None:
    """End the process at once if a thread still cannot write: the interpreter's own end would wait for it."""
    if any(thread.name.startswith(NAME) for thread in threading.enumerate()):
        os._exit(code)
