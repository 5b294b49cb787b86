"""The annotated video of a run, composed and encoded while the run goes on, beside it if asked."""

import os
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from skyherd.datasets import Mission
from skyherd.errors import OutputError
from skyherd.files.video_writer import VideoSink
from skyherd.jobs.helpers import Helper, can_help, one_thread
from skyherd.loop import Step
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.video.composer import Composer

FPS = 20
"""Frames a second of the video. Chosen: at half of it robots jump visibly; twice as many take twice the time
to draw and show nothing new."""

SPEED = 4
"""Simulated seconds that pass in one second of the video. Chosen: a mission of a minute takes 15 s to
watch."""

NICENESS = 19
"""Priority of the process that draws beside the loop. *Chosen*: the least, so that it has what the loop
leaves of the cores. *Measured* on two cores, whose loop has two processes: 40 s of `star` take 16.5 to 17.1 s
with it, 19.1 to 22.4 without."""

WAITING = 8
"""Steps that may wait to be drawn beside the loop. Chosen: 20 MB of images of six large cameras; with fewer
the loop waits more often where some frames take longer than others."""


class VideoRecorder(ExitStack):
    """A `skyherd.recording.writer.Recorder` that makes an MP4 file, a frame each `SPEED / FPS` seconds.

    The file is there, whole, after the context is left without an exception; else nothing is left of it.

    Args:
        mission: what is run.
        path: the file to make.
        beside: whether frames are composed and encoded by a process beside this one, where that is possible.
            What goes wrong there is raised by a later call.

    Raises:
        OutputError: the file cannot be made there, or it did not become whole.
    """

    def __init__(self, mission: Mission, path: Path, *, beside: bool = False) -> None:
        super().__init__()
        self._film: _Film | _FilmBeside
        self._film = _FilmBeside(mission, path) if beside and can_help() else _Film(mission, path)
        self.enter_context(self._film)
        self._next_s = 0.0

    def write(self, step: Step) -> None:
        """Have a frame of the step composed and appended, if it is time for one."""
        if step.time_s >= self._next_s - TIME_TOLERANCE_S:
            self._film.add(step)
            self._next_s += SPEED / FPS


class _Film(ExitStack):
    """A video file that is made of steps; the context gives it its name, or removes it after an exception.

    Attributes:
        sink: the file.
    """

    def __init__(self, mission: Mission, path: Path) -> None:
        super().__init__()
        self._composer = Composer(mission)
        self.sink = self.enter_context(VideoSink(path, self._composer.size_px, FPS))

    def add(self, step: Step) -> None:
        """Compose a frame of the step and append it."""
        self.sink.write(self._composer.compose(step))


class _FilmBeside(ExitStack):
    """The same, made by a helper of this process."""

    def __init__(self, mission: Mission, path: Path) -> None:
        super().__init__()
        gone = OutputError(f"{path}: the process that made it has ended by itself; is there enough memory?")
        self._part, self._unanswered = Path(), 0
        with ExitStack() as stack:
            stack.enter_context(one_thread())
            stack.callback(self._remove_part)
            self._helper = stack.enter_context(Helper(_Studio(mission, path).serve, gone, waiting=WAITING))
            self._helper.ask(_BEGIN)
            self._part = self._helper.answer()
            self.push(stack.pop_all())

    def add(self, step: Step) -> None:
        """Have a frame of the step composed and appended; it may wait for those before it."""
        while self._unanswered and self._helper.answered():
            self._take_answer()
        self._helper.ask(step)
        self._unanswered += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for all frames and name the file; or after an exception, remove what there is of it."""
        try:
            if error is None:
                self._helper.ask(_END)
                self._unanswered += 1
                while self._unanswered:
                    self._take_answer()
        finally:
            super().__exit__(kind, error, trace)

    def _take_answer(self) -> None:
        self._helper.answer()
        self._unanswered -= 1

    def _remove_part(self) -> None:
        """Remove the temporary file, which is there if the helper was closed before its end, or killed."""
        if self._part.name:
            self._part.unlink(missing_ok=True)


_BEGIN, _END = "begin", "end"
"""Requests beside steps: make the file; give it its name."""


class _Studio:
    """What the helper does."""

    def __init__(self, mission: Mission, path: Path) -> None:
        self._mission, self._path = mission, path

    def serve(self, request: Step | str) -> Path | None:
        """Begin the film and return the name of its temporary file; add a step to it; or end it."""
        if request == _BEGIN:
            os.nice(NICENESS)  # the encoder's threads begin after this, and have it too
            self._film = _Film(self._mission, self._path)
            return self._film.sink.part
        if isinstance(request, Step):
            self._film.add(request)
        else:
            self._film.close()
        return None
