"""How work that takes long reports its progress, without knowing whether and where that is shown.

Everything that can take long (a run, a study, a benchmark, a labelled data set, detection in a video) takes a
`Progress` as an argument of that name. The command line gives one that draws a bar on the terminal
(`skyherd.cli.console`); the default everywhere is `NO_PROGRESS`, which shows nothing.
"""

from typing import Protocol


class Progress(Protocol):
    """Display of the progress of a piece of work.

    Work may consist of several tasks, one after the other, such as the files of a folder. The worker calls
    `update` at the beginning of each task and then as often as it likes, from one thread. There is nothing to
    be called at the end: a task is over when another is named or when the work returns. The work
    waits for each call, which therefore must be quick and must not raise an exception.
    """

    def update(self, name: str, done: float, total: float | None, state: str | None = None) -> None:
        """Show the progress of the task of this name.

        Args:
            name: what is being done, in a few words; another name than before means another task.
            done: the amount that is done, in any unit: runs, images, simulated seconds.
            total: the amount at which the task is finished, in the same unit; None if it is not known.
            state: a few words about how it goes. If left out, done and total say it.
        """


class NoProgress:
    """A `Progress` that shows nothing."""

    def update(self, name: str, done: float, total: float | None, state: str | None = None) -> None:
        """Ignore the progress."""


NO_PROGRESS: Progress = NoProgress()
"""The default of every argument of type `Progress`."""
