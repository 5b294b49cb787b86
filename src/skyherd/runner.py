"""A run from start to finish: loop, recording, video, figures, summary and page.

The output folder receives `run.mcap`, `video.mp4`, `video-phone.mp4`, `figures/`, `summary.json` and
`report.html`.

The run writes its messages to MCAP as it proceeds. Figures, summary and page are always made from the
recording, so that `skyherd report` is the same code as the end of `skyherd run`. A killed run still has a
report, which lacks at most the last half second.
"""

import json
import shutil
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import Any

from skyherd.analysis.history import History, make_history
from skyherd.analysis.summary import summarize
from skyherd.datasets import Mission
from skyherd.errors import InputError, OutputError, SkyherdError
from skyherd.files.atomic import write_text
from skyherd.files.output_folder import OutputFolder
from skyherd.jobs.progress import NO_PROGRESS, Progress
from skyherd.loop import Step, run_steps
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.messages.checks import check_count, check_flags, check_kind
from skyherd.plots import panels
from skyherd.plots.panels import FigureFile, write_figures
from skyherd.recording.reader import Recording, read_recording, read_steps
from skyherd.recording.survey import describe_flaws
from skyherd.recording.writer import McapRecorder, Recorder
from skyherd.report.run_page import PAGE, PHONE_VIDEO, VIDEO, write_page
from skyherd.sim.perception import make_run_perception
from skyherd.sim.side_by_side import SideBySide
from skyherd.video.recorder import VideoRecorder

RECORDING, SUMMARY, FIGURES = "run.mcap", "summary.json", "figures"
"""Names of the recording, of the summary and of the figures' folder within a run's folder."""

VERB = "run"
"""Verb under which a folder's record lists the files of a run, including those of `skyherd report`."""

MAX_JOBS = 4096
"""Maximum number of cores of a run. *Chosen*: exceeds any machine."""

FREE_BYTES = 100 * 2**20
"""Minimum free disk space to start a run, bytes. Chosen: covers some minutes without recorded images; half of
it could fill the disk, twice as much would refuse sufficient disks."""


def output_names() -> list[str]:
    """Return the names of all files of a run, relative to its folder."""
    figures = [f"{FIGURES}/{panel.name}{kind}" for panel in panels.PANELS for kind in (".png", ".svg")]
    return [RECORDING, VIDEO, PHONE_VIDEO, SUMMARY, PAGE, *figures]


def _check_free_space(folder: Path) -> None:
    """Reject a disk with less than `FREE_BYTES` free; the folder need not exist yet."""
    there = next((place for place in (folder, *folder.absolute().parents) if place.is_dir()), Path())
    free = shutil.disk_usage(there).free
    if free < FREE_BYTES:
        raise InputError(str(folder), f"{free // 2**20} MiB free", f"at least {FREE_BYTES // 2**20} MiB")


def run_mission(
    mission: Mission,
    folder: Path | str,
    *,
    force: bool = False,
    video: bool = True,
    record_images: bool = False,
    jobs: int = 1,
    recorders: Sequence[Recorder] = (),
    progress: Progress = NO_PROGRESS,
    on_step: Callable[[Step], None] = lambda step: None,
) -> dict[str, Any]:
    """Run a mission into a folder, and make its report.

    The first step is computed before the folder changes, so that invalid input leaves earlier results intact.
    An interrupted run, or one with a full disk, leaves its recording, from which `make_report` makes a
    report. A run that is refused later leaves nothing.

    Args:
        mission: mission to run.
        folder: folder of the results.
        force: write into an existing folder, and remove only what an earlier run left there.
        video: make a video.
        record_images: keep the cameras' images in the recording, as JPEG.
        jobs: number of cores to use, where processes can be forked. With more than one, cameras, video and
            figures are drawn in parallel. Results are the same.
        recorders: additional recorders; they are entered and exited here.
        progress: receives the simulated time, and as the state V and the number of detected markers.
        on_step: callback for every recorded step.

    Returns:
        the run's summary, as `skyherd.analysis.summary.summarize` makes it.

    Raises:
        InputError: an argument has a wrong type; the folder exists without `force`, holds a foreign file of
            the same name, or is not usable; or an image of the mission cannot be read.
        OutputError: a file could not be written, as on a full disk.
    """
    check_kind("run_mission: folder", folder, (str, Path), "a path")
    check_count("run_mission: jobs", jobs, least=1, most=MAX_JOBS)
    check_flags("run_mission", force=force, video=video, record_images=record_images)
    folder = Path(folder)
    output = OutputFolder(folder, VERB, output_names(), force=force)
    output.check()
    started_s = perf_counter()
    check_kind("run_mission: mission", mission, Mission, "a Mission, as load_mission returns it")
    perception = SideBySide(make_run_perception(mission), jobs)
    steps = run_steps(mission, perception)
    first = next(steps)
    _check_free_space(folder)
    with output:
        try:
            with ExitStack() as films:
                film = None
                if video:
                    film = films.enter_context(VideoRecorder(mission, folder / VIDEO, beside=jobs > 1))
                recording = McapRecorder(folder / RECORDING, mission, images=record_images)
                with ExitStack() as stack:
                    stack.enter_context(recording)
                    entered: list[Recorder] = [recording, *([film] if film else [])]
                    entered += map(stack.enter_context, recorders)
                    stack.enter_context(perception)
                    for step in chain([first], steps):
                        for recorder in entered:
                            recorder.write(step)
                        output.keep()
                        on_step(step)
                        _report_step(progress, mission, step)
                    recording.finish(step.time_s, perf_counter() - started_s)
                recorded = _Recorded.read(folder)
                if film:
                    film.conclude(recorded.summary["verdict"], is_good=recorded.summary["converged"])
                figures = _draw_figures(folder, recorded, jobs)  # while the film is compressed
            return _write_report(folder, recorded, figures)
        except InputError:
            output.discard()
            raise
        except SkyherdError:
            raise
        except OSError as error:
            what = f"{error.filename or folder}: {error.strerror or error}"
            left = "free some space; `skyherd report` shows the recorded part"
            raise OutputError(f"{what}; {left}") from None


def _report_step(progress: Progress, mission: Mission, step: Step) -> None:
    """Report the simulated time, V, and the share of whole markers that were detected."""
    name, duration_s = mission.scenario.name, mission.scenario.duration_s
    sights = [frame.sight for frame in step.frames.values()]
    found, whole = sum(s.found_ids.size for s in sights), sum(s.whole_ids.size for s in sights)
    state = f"{step.time_s:.0f}/{duration_s:g} s  V {step.metrics.V:.3g} m²  found {found}/{whole}"
    if step.time_s >= duration_s - TIME_TOLERANCE_S:
        state = "drawing figures and page …"
    progress.update(name, step.time_s, duration_s, state)


def make_report(folder: Path, *, film: bool = True, embed: bool = False, jobs: int = 1) -> dict[str, Any]:
    """Make figures, summary and page from the recording in a folder, and return the summary.

    The summary's key `recording` lists what an incomplete recording lacks.

    Args:
        folder: a run's folder.
        film: also remake the video, if the recording has the cameras' images.
        embed: put videos and replay into the page, so that it can be sent alone.
        jobs: number of cores to use, as in `run_mission`.

    Raises:
        InputError: the folder holds no readable recording, or a foreign file that the report would replace.
        OutputError: a file could not be written.
    """
    recorded = _Recorded.read(folder)
    names = [name for name in output_names() if name not in (RECORDING, VIDEO, PHONE_VIDEO)]
    filmed = film and recorded.recording.has_images
    films = [VIDEO, PHONE_VIDEO] if filmed else []
    output = OutputFolder(folder, VERB, [*names, *films], resume=True, elsewhere=None)
    with output:
        if filmed:
            with VideoRecorder(recorded.recording.mission, folder / VIDEO, beside=jobs > 1) as recorder:
                for step in read_steps(folder / RECORDING):
                    recorder.write(step)
                recorder.conclude(recorded.summary["verdict"], is_good=recorded.summary["converged"])
        return _write_report(folder, recorded, _draw_figures(folder, recorded, jobs), embed=embed)


@dataclass(frozen=True)
class _Recorded:
    """A folder's recording with its history and summary."""

    recording: Recording
    history: History
    summary: dict[str, Any]

    @classmethod
    def read(cls, folder: Path) -> "_Recorded":
        recording = read_recording(folder / RECORDING)
        history = make_history(recording.mission, recording.steps)
        summary = summarize(history, recording.wall_s)
        if recording.flaws:
            summary["recording"] = describe_flaws(recording.flaws)
        return cls(recording, history, summary)


def _draw_figures(folder: Path, recorded: _Recorded, jobs: int) -> list[FigureFile]:
    """Draw the figures of a recording into its folder."""
    (folder / FIGURES).mkdir(exist_ok=True)
    return write_figures(recorded.history, folder / FIGURES, jobs=jobs)


def _write_report(
    folder: Path, recorded: _Recorded, figures: list[FigureFile], *, embed: bool = False
) -> dict[str, Any]:
    """Write summary and page of a recording into its folder, beside film and figures; return the summary."""
    recording, summary = recorded.recording, recorded.summary
    write_text(folder / SUMMARY, json.dumps(summary, indent=2) + "\n")
    scenario = json.dumps(recording.mission.scenario.model_dump(mode="json", exclude_none=True), indent=2)
    write_page(
        folder,
        history=recorded.history,
        summary=summary,
        figures=figures,
        versions=recording.versions,
        scenario_text=scenario,
        embed=embed,
    )
    return summary
