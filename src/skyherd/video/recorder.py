"""Annotated video of a run, composed and encoded during the run, optionally in a process of its own."""

import os
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from skyherd.datasets import Mission
from skyherd.errors import OutputError
from skyherd.files.video_writer import VideoSink
from skyherd.geometry import RgbImage
from skyherd.jobs.helpers import Helper, can_help, one_thread
from skyherd.loop import Step
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.video.composer import Composer

FPS = 20
"""Frames per second of the video. Chosen: at half of it robots jump visibly; twice as many take twice the
time to draw and show nothing new."""

NICENESS = 19
"""Niceness of the drawing process. *Chosen*: the lowest priority, so that it uses cores that the loop leaves.
*Measured* on two cores: 40 s of `star` take 16.5 to 17.1 s, without it 19.1 to 22.4 s."""

MIN_WAITING, WAITING_BYTES = 8, 200_000_000
"""Number of steps that may wait for the drawing process, and bytes of the images of more. Chosen: 104 steps
of `star`, so that the first frames are drawn while the loop goes on, on cores that it leaves."""

END_S = 2
"""Time for which a video shows its last frame with the verdict, s. Chosen: long enough to read it."""


def phone_path(path: Path) -> Path:
    """Return the path of the video for phones beside a video."""
    return path.with_name(f"{path.stem}-phone{path.suffix}")


class VideoRecorder(ExitStack):
    """A `skyherd.recording.writer.Recorder` that makes two MP4 files, a frame each `video.speed / FPS` s.

    One is wide, the other has its panels one below the other, for phones (`phone_path`). With
    `video.end = "held"`, no frame shows a shape that has been held for longer than `video.after_s`.

    The files are complete after the context is exited without an exception; else nothing is left of them.

    Args:
        mission: mission of the run.
        path: the wide file to make.
        beside: compose and encode in a process of its own, where that is possible. A later call raises its
            errors.

    Raises:
        OutputError: a file cannot be made there, or it is incomplete.
    """

    def __init__(self, mission: Mission, path: Path, *, beside: bool = False) -> None:
        super().__init__()
        self._film: _Film | _FilmBeside
        self._film = _FilmBeside(mission, path) if beside and can_help() else _Film(mission, path)
        self.enter_context(self._film)
        self._next_s, self._frame_s = 0.0, mission.scenario.video.speed / FPS
        self._ending = _Ending(mission)

    def write(self, step: Step) -> None:
        """Have the frames of the step that are due composed and appended."""
        due = int((step.time_s - self._next_s + TIME_TOLERANCE_S) // self._frame_s) + 1
        self._next_s += max(due, 0) * self._frame_s
        if self._ending.shows(step) and due > 0:
            self._film.add(step, due)

    def conclude(self, verdict: str, *, is_good: bool) -> None:
        """End the video with the verdict on the run below its name, for `END_S`."""
        self._film.conclude(verdict, is_good)


class _Ending:
    """Rule of the scenario's table `video` on the end of the video."""

    def __init__(self, mission: Mission) -> None:
        scenario = mission.scenario
        self._goal, self._rule, self._since_s = scenario.goal, scenario.video, 0.0
        changes_s = [at_s for at_s, _ in mission.later]
        for unit in scenario.units:
            changes_s += [time_s for outage in unit.outages for time_s in outage]
            changes_s += [time_s for time_s, _ in unit.zoom]
        changes_s += [intervention.at_s for intervention in scenario.interventions]
        changes_s += [time_s for time_s, _ in mission.schedule.motions]
        self._least_s = max((time_s for time_s in changes_s if time_s <= scenario.duration_s), default=0.0)
        if not mission.schedule.motion_at(scenario.duration_s).is_rest:
            self._least_s = scenario.duration_s

    def shows(self, step: Step) -> bool:
        """Return whether the video shows a step; called with all steps in the order of time."""
        if not step.metrics.shape.error < self._goal.shape_error:
            self._since_s = step.time_s
        held_from_s = max(self._since_s, self._least_s) + self._goal.hold_s
        return self._rule.end == "run" or step.time_s <= held_from_s + self._rule.after_s + TIME_TOLERANCE_S


class _Film(ExitStack):
    """Video files made of steps; its context names them on success, and removes them after an exception.

    Attributes:
        sinks: the wide file, and the one for phones.
    """

    def __init__(self, mission: Mission, path: Path) -> None:
        super().__init__()
        self._composers = [Composer(mission), Composer(mission, phone=True)]
        with ExitStack() as stack:
            self.sinks = [
                stack.enter_context(VideoSink(place, composer.size_px, FPS))
                for place, composer in zip((path, phone_path(path)), self._composers, strict=True)
            ]
            self.push(stack.pop_all())

    def add(self, step: Step, copies: int) -> None:
        """Compose the frames of the step and append each as often as `copies`."""
        self._append([composer.compose(step) for composer in self._composers], copies)

    def conclude(self, verdict: str, is_good: bool) -> None:
        """Append the last frames with the verdict."""
        ends = [composer.conclude(verdict, is_good=is_good) for composer in self._composers]
        self._append(ends, END_S * FPS)

    def _append(self, pictures: list[RgbImage], copies: int) -> None:
        for sink, picture in zip(self.sinks, pictures, strict=True):
            for _ in range(copies):
                sink.write(picture)


class _FilmBeside(ExitStack):
    """A `_Film` in a helper of this process."""

    def __init__(self, mission: Mission, path: Path) -> None:
        super().__init__()
        gone = OutputError(f"{path}: the process that made it ended unexpectedly; is there enough memory?")
        self._parts: list[Path] = []
        self._unanswered = 0
        with ExitStack() as stack:
            stack.enter_context(one_thread())
            stack.callback(self._remove_parts)
            studio = Helper(_Studio(mission, path).serve, gone, waiting=_waiting(mission))
            self._helper = stack.enter_context(studio)
            self._helper.ask(_BEGIN)
            self._parts = self._helper.answer()
            self.push(stack.pop_all())

    def add(self, step: Step, copies: int) -> None:
        """Have a frame of the step composed and appended; wait if too many are pending."""
        while self._unanswered and self._helper.answered():
            self._take_answer()
        self._ask((step, copies))

    def conclude(self, verdict: str, is_good: bool) -> None:
        """Have the last frames with the verdict appended."""
        self._ask((verdict, is_good))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for all frames and name the file; after an exception, remove its remains."""
        try:
            if error is None:
                self._ask(_END)
                while self._unanswered:
                    self._take_answer()
        finally:
            super().__exit__(kind, error, trace)

    def _ask(self, request: "_Request") -> None:
        self._helper.ask(request)
        self._unanswered += 1

    def _take_answer(self) -> None:
        self._helper.answer()
        self._unanswered -= 1

    def _remove_parts(self) -> None:
        """Remove the temporary files of a helper that was closed early or killed."""
        for part in self._parts:
            part.unlink(missing_ok=True)


def _waiting(mission: Mission) -> int:
    """Return the number of steps that may wait for the drawing process."""
    pixels = sum(width * height for width, height in (unit.camera.size_px for unit in mission.scenario.units))
    return max(MIN_WAITING, WAITING_BYTES // pixels)


_Request = tuple[Step, int] | tuple[str, bool] | str
"""A step and its copies, a verdict and whether it is good, or `_BEGIN` or `_END`."""

_BEGIN, _END = "begin", "end"
"""Requests beside steps: create the file; give it its name."""


class _Studio:
    """Request handler of the helper."""

    def __init__(self, mission: Mission, path: Path) -> None:
        self._mission, self._path = mission, path

    def serve(self, request: _Request) -> list[Path] | None:
        """Begin the film and return the names of its temporary files; add to it; or end it."""
        if request == _BEGIN:
            os.nice(NICENESS)  # The encoder's threads start later and inherit it.
            self._film = _Film(self._mission, self._path)
            return [sink.part for sink in self._film.sinks]
        if not isinstance(request, tuple):
            self._film.close()
        elif isinstance(request[0], str):
            self._film.conclude(request[0], bool(request[1]))
        else:
            self._film.add(request[0], request[1])
        return None
