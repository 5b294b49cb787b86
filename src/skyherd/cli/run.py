"""`skyherd run`: run a scenario and leave its recording, video, figures, summary and page in a folder."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skyherd.cli.console import ProgressReporter, say, warn
from skyherd.cli.interrupts import NOTHING_LEFT, telling_of_interrupts
from skyherd.cli.options import ForceFolder, Perception, Scenario, ScenarioSettings

if TYPE_CHECKING:
    from skyherd.datasets import Mission
    from skyherd.loop import Step


def run(
    scenario: Scenario,
    out_dir: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", show_default="runs/NAME", help="Write the results into this new folder."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="Replace the scenario's seed of all random draws.")
    ] = None,
    settings: ScenarioSettings = None,
    perception: Perception = None,
    no_video: Annotated[bool, typer.Option("--no-video", help="Do not make a video.")] = False,
    record_images: Annotated[
        bool, typer.Option("--record-images", help="Keep the cameras' images in the recording, as JPEG.")
    ] = False,
    jobs: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Use this many cores instead of all. Results are the same."),
    ] = None,
    force: ForceFolder = False,
) -> int:
    """Run a scenario; write its recording, video, figures and page.

    Exit code 0 if the shape was reached, 1 if not, 2 for bad input.
    """
    from skyherd.datasets import load_mission
    from skyherd.jobs.helpers import cores
    from skyherd.runner import run_mission

    chosen = [*(settings or []), *([f"perception={perception}"] if perception else [])]
    mission = load_mission(scenario, chosen, seed=seed)
    folder = out_dir or Path("runs") / mission.scenario.name
    _warn_of_slow_cameras(mission)
    _warn_of_the_radio(mission)
    with (
        telling_of_interrupts(lambda: _what_is_left(folder)),
        ProgressReporter() as progress,
    ):
        summary = run_mission(
            mission,
            folder,
            force=force,
            video=not no_video,
            record_images=record_images,
            jobs=jobs or cores(),
            progress=progress,
            on_step=_FirstImages(mission).check,
        )
    _say_result(summary, folder)
    return 0 if summary["converged"] else 1


def _what_is_left(folder: Path) -> str:
    """Return the text about the files of an interrupted run; before its first step it has removed them."""
    from skyherd.runner import RECORDING

    if not (folder / RECORDING).exists():
        return NOTHING_LEFT
    return f"the recorded part can be shown by `skyherd report {folder}`"


def _warn_of_slow_cameras(mission: "Mission") -> None:
    """Warn of units between whose images the robots forget their goals."""
    for unit, model in enumerate(mission.scenario.units):
        if mission.scenario.robots.timeout_s * model.frame_rate_hz < 1:
            warn(f"unit {unit} takes images less often than robots.timeout_s: its robots stop and go")


def _warn_of_the_radio(mission: "Mission") -> None:
    """Warn of units that negotiate a tree, but have no contact or may lose it in flight."""
    from skyherd.analysis.radio_check import foresee_radio

    for warning in foresee_radio(mission):
        warn(warning)


class _FirstImages:
    """Warns of each unit whose first image shows no robot."""

    def __init__(self, mission: "Mission") -> None:
        self._robots = frozenset(mission.ids.tolist())
        self._started: set[int] = set()

    def check(self, step: "Step") -> None:
        """Look at the first images among those of one step."""
        for unit, frame in step.frames.items():
            if unit not in self._started and self._robots.isdisjoint(frame.sight.whole_ids.tolist()):
                warn(f"unit {unit} sees no robot at the start")
            self._started.add(unit)


def _say_result(summary: dict[str, Any], folder: Path) -> None:
    """Print the result in a few lines."""
    from skyherd.report.run_page import PAGE, VIDEO

    recall = summary["detection_recall"]
    say(summary["verdict"], bold=True)
    say(f"scale {summary['scale']:.4g} m a unit, V {summary['V_start']:.4g} → {summary['V_end']:.3g} m²")
    say(
        f"{summary['steps']} steps, {summary['frames']} images, "
        f"recall {'–' if recall is None else format(recall, '.2%')}, "
        f"{summary['topology_changes']} topology changes, {summary['wall_s']:.1f} s"
    )
    films = [folder / VIDEO] if (folder / VIDEO).exists() else []
    say("see " + "  ".join(str(path) for path in [folder / PAGE, *films]))
