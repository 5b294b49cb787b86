"""The annotated video of a run, written while the run goes on."""

from contextlib import ExitStack
from pathlib import Path

from skyherd.datasets import Mission
from skyherd.files.video_writer import VideoSink
from skyherd.loop import Step
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.video.composer import Composer

FPS = 20
"""Frames a second of the video. Chosen: at half of it robots jump visibly; twice as many take twice the time
to draw and show nothing new."""

SPEED = 4
"""Simulated seconds that pass in one second of the video. Chosen: a mission of a minute takes 15 s to
watch."""


class VideoRecorder(ExitStack):
    """A `skyherd.recording.writer.Recorder` that makes an MP4 file, a frame each `SPEED / FPS` seconds.

    The file is there, whole, after the context is left without an exception; else nothing is left of it.

    Args:
        mission: what is run.
        path: the file to make.

    Raises:
        OutputError: the file cannot be made there, or it did not become whole.
    """

    def __init__(self, mission: Mission, path: Path) -> None:
        super().__init__()
        self._composer = Composer(mission)
        self._sink = self.enter_context(VideoSink(path, self._composer.size_px, FPS))
        self._next_s = 0.0

    def write(self, step: Step) -> None:
        """Compose a frame of the step and append it, if it is time for one."""
        if step.time_s >= self._next_s - TIME_TOLERANCE_S:
            self._sink.write(self._composer.compose(step))
            self._next_s += SPEED / FPS
