"""The terminal of a run: a dashboard, or lines. Threads of their own write to it (`line_writer`)."""

import threading
from collections.abc import Callable
from contextlib import suppress

from rich.console import Console, RenderableType
from rich.live import Live

from skyherd.live import line_writer
from skyherd.live.line_writer import LineWriter

MAX_LINES = 1000
"""Number of lines that wait while the terminal is held; older ones are only in the log. Chosen: some minutes
of a troubled run."""


class Screen:
    """Lines, or a dashboard that fills the terminal. Only `close` waits for the terminal.

    While the terminal is held, the newest dashboard replaces the others, and new lines wait.

    Args:
        console: terminal of the dashboard; None to print lines instead.
        say: prints a line.
    """

    def __init__(self, console: Console | None, say: Callable[[str], None]) -> None:
        self._page: RenderableType | None = None
        self._news, self._closing = threading.Condition(), False
        self._lines = None if console is not None else LineWriter(say, MAX_LINES)
        self._thread: threading.Thread | None = None
        if console is not None:
            name, given = f"{line_writer.NAME} of the dashboard", (console,)
            self._thread = threading.Thread(target=self._show_pages, args=given, name=name, daemon=True)
            self._thread.start()

    def tell(self, line: str) -> None:
        """Print a line soon, unless there is a dashboard."""
        if self._lines is not None:
            self._lines.put(line)

    def draw(self, page: RenderableType) -> None:
        """Show a dashboard soon, if there is one."""
        with self._news:
            self._page = page
            self._news.notify()

    def close(self) -> bool:
        """Print the lines that wait, or leave the dashboard. Return False if the terminal is still held."""
        if self._thread is None:
            return self._lines is None or self._lines.close()
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join(line_writer.CLOSE_S)
        return not self._thread.is_alive()

    def _show_pages(self, console: Console) -> None:
        """Show dashboards until `close`, or until the terminal is gone, which does not end the run."""
        # Redirected output would take a lock that this thread holds while it writes.
        with (
            suppress(OSError, ValueError),
            Live(
                console=console, screen=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False
            ) as live,
        ):
            while True:
                with self._news:
                    self._news.wait_for(lambda: self._page is not None or self._closing)
                    page, self._page = self._page, None
                    if page is None:
                        return
                live.update(page, refresh=True)
