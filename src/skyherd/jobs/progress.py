"""Interface by which long-running work reports its progress.

Functions that can take long (a run, a study, a benchmark, a labelled data set, detection in a video) have an
argument `progress`. The command line passes a progress bar (`skyherd.cli.console`). The default is
`NO_PROGRESS`, which shows nothing.
"""

from typing import Protocol


class Progress(Protocol):
    """Display of the progress of long-running work.

    Work may consist of consecutive tasks, such as the files of a folder. It calls `update` at the beginning
    of each task, and then at any rate, from one thread. A task is over when the work names another one, or
    returns. Each call blocks the work, so it must be quick. It must not raise an exception.
    """

    def update(self, name: str, done: float, total: float | None, state: str | None = None) -> None:
        """Show the progress of a task.

        Args:
            name: name of the task, in a few words; a new name starts a new task.
            done: completed amount, in any unit: runs, images, simulated seconds.
            total: amount of the whole task, in the same unit; None if unknown.
            state: status in a few words; by default the display shows `done` and `total`.
        """


class NoProgress:
    """A `Progress` that shows nothing."""

    def update(self, name: str, done: float, total: float | None, state: str | None = None) -> None:
        """Ignore the progress."""


NO_PROGRESS: Progress = NoProgress()
"""Default of all arguments of type `Progress`."""
