"""Progress reports of long-running work, independent of their display.

Functions that may take long have an argument `progress`: runs, studies, benchmarks, labelled data sets, and
detection in videos. The command line passes an object that draws a bar (`skyherd.cli.console`). The default
is `NO_PROGRESS`, which shows nothing.
"""

from typing import Protocol


class Progress(Protocol):
    """Display of the progress of a piece of work.

    Work may consist of several successive tasks, such as the files of a folder. The worker calls `update`
    from one thread, at the start of each task and at any time later. A task ends when another is named or
    when the work returns. Each call blocks the work, so that it must be fast and must not raise an exception.
    """

    def update(self, name: str, done: float, total: float | None, state: str | None = None) -> None:
        """Show the progress of the task of this name.

        Args:
            name: short name of the task; a new name starts a new task.
            done: completed amount, in any unit: runs, images, simulated seconds.
            total: amount of the whole task, in the same unit; None if unknown.
            state: short description of the state; by default done and total.
        """


class NoProgress:
    """Progress that shows nothing."""

    def update(self, name: str, done: float, total: float | None, state: str | None = None) -> None:
        """Ignore the progress."""


NO_PROGRESS: Progress = NoProgress()
"""Default of arguments of type `Progress`."""
