"""A run from start to finish: the loop, its recording and video, and what is made of them.

Left in the output folder: `run.mcap`, `video.mp4`, `figures/`, `summary.json`, `report.html`.
"""

import json
import shutil
from collections.abc import Callable
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import Any

from skyherd.analysis.history import make_history
from skyherd.analysis.summary import summarize
from skyherd.datasets import Mission
from skyherd.errors import InputError
from skyherd.files.atomic import refuse_existing, write_text
from skyherd.files.video_writer import VideoSink
from skyherd.loop import Step, run_steps
from skyherd.plots.panels import PANELS, write_figures
from skyherd.recording.reader import read_recording, read_steps
from skyherd.recording.writer import Recorder
from skyherd.report.run_page import PAGE, VIDEO, write_page
from skyherd.video.composer import Composer

RECORDING, SUMMARY, FIGURES = "run.mcap", "summary.json", "figures"
FREE_BYTES = 100 * 2**20
VIDEO_FPS = 20
VIDEO_SPEED = 4
"""Simulated seconds a second of video."""


def prepare_folder(folder: Path) -> None:
    """Make an output folder and clear what an earlier run left in it; other files are left alone.

    Raises:
        InputError: it cannot be written to, or the disk is nearly full.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".skyherd-probe"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise InputError(
            str(folder), error.strerror or str(error), "a folder that can be written to"
        ) from None
    free = shutil.disk_usage(folder).free
    if free < FREE_BYTES:
        raise InputError(str(folder), f"{free // 2**20} MiB free", f"at least {FREE_BYTES // 2**20} MiB")
    figures = [folder / FIGURES / f"{panel.name}{kind}" for panel in PANELS for kind in (".png", ".svg")]
    for path in (*(folder / name for name in (RECORDING, VIDEO, SUMMARY, PAGE)), *figures):
        path.unlink(missing_ok=True)


def run_mission(
    mission: Mission,
    folder: Path,
    *,
    force: bool = False,
    video: bool = True,
    record_images: bool = False,
    on_step: Callable[[Step], None] = lambda step: None,
) -> dict[str, Any]:
    """Run a mission into a folder and return its summary; `on_step` watches.

    The first step is taken before the folder is touched: what it refuses leaves an earlier run whole.

    Raises:
        InputError: the folder exists without `force` or cannot be used, or the mission's images are no good.
    """
    refuse_existing(folder, force=force)
    started_s = perf_counter()
    steps = run_steps(mission)
    first = next(steps)
    prepare_folder(folder)
    with ExitStack() as stack:
        recorder = stack.enter_context(Recorder(folder / RECORDING, mission, images=record_images))
        film = stack.enter_context(Film(mission, folder / VIDEO)) if video else None
        for step in chain([first], steps):
            recorder.write(step)
            if film is not None:
                film.show(step)
            on_step(step)
        recorder.finish(step.time_s, perf_counter() - started_s)
    return make_report(folder, film=False)


class Film(ExitStack):
    """The annotated video of a run, one frame each `VIDEO_SPEED / VIDEO_FPS` simulated seconds."""

    def __init__(self, mission: Mission, path: Path) -> None:
        super().__init__()
        self._composer = Composer(mission)
        self._sink = self.enter_context(VideoSink(path, self._composer.size_px, VIDEO_FPS))
        self._next_s = 0.0

    def show(self, step: Step) -> None:
        """Compose and write a frame, if it is time for one."""
        if step.time_s >= self._next_s - 1e-9:
            self._sink.write(self._composer.compose(step))
            self._next_s += VIDEO_SPEED / VIDEO_FPS


def make_report(folder: Path, *, film: bool = True) -> dict[str, Any]:
    """Make figures, summary and page from the recording in a folder; with `film`, a video of its images too.

    Raises:
        InputError: the folder holds no readable recording.
    """
    recording = read_recording(folder / RECORDING)
    if film and recording.has_images:
        _film_again(recording.mission, folder)
    history = make_history(recording.mission, recording.steps)
    summary = summarize(history, recording.wall_s)
    (folder / FIGURES).mkdir(exist_ok=True)
    figures = write_figures(history, folder / FIGURES)
    write_text(folder / SUMMARY, json.dumps(summary, indent=2) + "\n")
    scenario = json.dumps(recording.mission.scenario.model_dump(mode="json", exclude_none=True), indent=2)
    write_page(folder, history, summary, figures, recording.versions, scenario)
    return summary


def _film_again(mission: Mission, folder: Path) -> None:
    with Film(mission, folder / VIDEO) as film:
        for step in read_steps(folder / RECORDING):
            film.show(step)
