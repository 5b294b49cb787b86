"""The terminal of a run. A thread of its own writes to it, because a held terminal blocks its writer."""

import os
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress

from rich.console import Console, RenderableType
from rich.live import Live

THREAD = "screen"
"""Name of the thread that writes."""

MAX_LINES = 1000
"""Number of lines that wait while the terminal is held; older ones are only in the log. Chosen: some minutes
of a troubled run."""

CLOSE_S = 2.0
"""Longest wait for the terminal at the end, s. Chosen: longer than a slow link needs for a dashboard."""


class Screen:
    """Lines, or a dashboard that fills the terminal, written by a thread of its own.

    A terminal takes no output after Ctrl-S, during a selection, or over a connection that stalls; a pipe
    takes none while it is full. Meanwhile the newest dashboard replaces the others, and new lines wait.

    Args:
        console: terminal of the dashboard; None to print lines instead.
        say: prints a line.
    """

    def __init__(self, console: Console | None, say: Callable[[str], None]) -> None:
        self._console, self._say = console, say
        self._page: RenderableType | None = None
        self._lines: deque[str] = deque(maxlen=MAX_LINES)
        self._news, self._closing = threading.Condition(), False
        self._thread = threading.Thread(target=self._run, name=THREAD, daemon=True)
        self._thread.start()

    def tell(self, line: str) -> None:
        """Print a line soon, unless there is a dashboard."""
        with self._news:
            self._lines.append(line)
            self._news.notify()

    def draw(self, page: RenderableType) -> None:
        """Show a dashboard soon, if there is one."""
        with self._news:
            self._page = page
            self._news.notify()

    def close(self) -> bool:
        """Print the lines that wait, and leave the dashboard. Return False if the terminal is still held."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join(CLOSE_S)
        return not self._thread.is_alive()

    def _run(self) -> None:
        """Write until `close`, or until the terminal is gone, which does not end the run."""
        with suppress(OSError, ValueError):
            if self._console is None:
                self._print_lines()
                return
            # Redirected output would take a lock that this thread holds while it writes.
            with Live(
                console=self._console,
                screen=True,
                auto_refresh=False,
                redirect_stdout=False,
                redirect_stderr=False,
            ) as live:
                self._show_pages(live)

    def _print_lines(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._lines or self._closing)
                if not self._lines:
                    return
                line = self._lines.popleft()
            self._say(line)

    def _show_pages(self, live: Live) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._page is not None or self._closing)
                page, self._page = self._page, None
                if page is None:
                    return
            live.update(page, refresh=True)


def leave_held_terminal(code: int) -> None:
    """End the process at once if its terminal is still held: the interpreter's own end would wait for it."""
    if any(thread.name == THREAD for thread in threading.enumerate()):
        os._exit(code)
