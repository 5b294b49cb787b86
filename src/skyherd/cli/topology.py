"""`skyherd topology`: control sets, TC1-TC5 with the reasons of violations, and the convergence rate."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyherd.cli.choices import complete_scenario
from skyherd.cli.console import say, say_table, warn
from skyherd.cli.options import ForceFile
from skyherd.errors import InputError

if TYPE_CHECKING:
    from skyherd.analysis.history import History
    from skyherd.analysis.topology_report import TopologyReport
    from skyherd.datasets import Mission

PICTURES = (".png", ".svg")
"""Kinds of picture that can be written, by the end of the file's name."""

MAX_CHANGES = 60
"""Changes of the topology that are listed; the rest are counted. Chosen: two screens."""

REACHED_ERROR = 0.01
"""Shape error at which the shape counts as reached in the predicted and measured times: 1 %. Chosen."""

MIN_RATE = 1e-9
"""A slowest mode below this, in units of the gain, is rounding, and shown as zero: the team is split."""


def topology(
    source: Annotated[
        str,
        typer.Argument(
            metavar="FILE|RUN",
            help="A scenario, such as star, or a run: its folder or its run.mcap.",
            autocompletion=complete_scenario,
        ),
    ],
    picture: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            show_default="topology.png in the run's folder, NAME-topology.png for a scenario",
            help="Write the picture into this file, as PNG or SVG.",
        ),
    ] = None,
    force: ForceFile = False,
) -> int:
    """Show which unit controls which robots, and check TC1-TC5.

    A scenario is judged after deployment, a run at its end.

    Units that overlap freely (selection.kind "radius") require TC1 and TC2 only.

    Exit code 0 if the required conditions hold, 1 if one is violated, 2 for bad input.
    """
    from skyherd.analysis.foresight import living_sets
    from skyherd.analysis.topology_report import judge_topology
    from skyherd.files.output_file import OutputFile

    if picture is not None:
        if picture.suffix not in PICTURES:
            allowed = f"a name that ends in {' or '.join(PICTURES)}"
            raise InputError(str(picture), "is not a picture", allowed)
        OutputFile(picture, "topology", force=force).check()
    history, default, is_run = _open(source)
    path = picture or default
    output = OutputFile(path, "topology", force=force)
    output.check()
    report = judge_topology(living_sets(history), history.shape)
    _say_graph(report, history)
    _say_conditions(report, history.mission)
    _say_prediction(report, history, is_run=is_run)
    if is_run:
        _say_changes(history)
    with output:
        _draw(report, history, path)
    say(f"see {path}")
    return 1 if _broken(report, history.mission) else 0


def _broken(report: "TopologyReport", mission: "Mission") -> list[int]:
    """Return the violated conditions among those that the mission requires, ascending."""
    from skyherd.analysis.topology_report import required_conditions

    broken = sorted({breach.condition for breach in report.breaches})
    return [number for number in broken if number <= required_conditions(mission)]


def _open(source: str) -> tuple["History", Path, bool]:
    """Return the history, the path of its picture, and whether it is of a run."""
    from skyherd.analysis.foresight import deploy
    from skyherd.analysis.history import make_history
    from skyherd.datasets import load_mission
    from skyherd.recording.reader import read_recording
    from skyherd.recording.survey import describe_flaws
    from skyherd.runner import RECORDING

    path = Path(source)
    if os.path.isdir(path):
        if not os.path.lexists(path / RECORDING):
            allowed = "a scenario, or the output folder of `skyherd run`"
            raise InputError(source, f"no {RECORDING} in it", allowed)
        path = path / RECORDING
    if path.suffix == ".mcap":
        recording = read_recording(path)
        if recording.flaws:
            warn(f"{path}: {describe_flaws(recording.flaws)}")
        return make_history(recording.mission, recording.steps), path.with_name("topology.png"), True
    mission = load_mission(source)
    history, is_ready = deploy(mission)
    if not is_ready:
        warn(f"the tree of units was not complete after {history.times_s[-1]:g} s; its last state is shown")
    return history, Path(f"{mission.scenario.name}-topology.png"), False


def _draw(report: "TopologyReport", history: "History", path: Path) -> None:
    """Write the picture of the graph; its title says when it was, and what the conditions say."""
    from skyherd.analysis.topology_report import required_conditions
    from skyherd.files.atomic import write_whole
    from skyherd.plots.graph import draw_graph
    from skyherd.plots.style import DPI, drawing_style

    required = required_conditions(history.mission)
    names = ", ".join(f"TC{number}" for number in _broken(report, history.mission))
    verdict = f"violated: {names}" if names else f"TC1-TC{required} hold"
    at = f"{history.mission.scenario.name} at {history.times_s[-1]:.1f} s"
    with drawing_style():
        figure = draw_graph(history)
        title = f"{at} · {verdict} · slowest mode λ = {report.slowest:.3g}"
        figure.axes[0].set_title(title, fontsize=10, loc="left")
        write_whole(path, lambda part: figure.savefig(part, format=path.suffix[1:], dpi=DPI))


def _say_graph(report: "TopologyReport", history: "History") -> None:
    """Print each unit, how many robots it controls, and which of them it shares with whom."""
    say(f"{history.mission.scenario.name} at {history.times_s[-1]:.1f} s", bold=True)
    rows = []
    for unit, robots in report.sets.items():
        bonds = [
            f"{k if j == unit else j}: {', '.join(map(str, common))}"
            for (j, k), common in report.shared.items()
            if unit in (j, k)
        ]
        rows.append((str(unit), str(robots.size), "   ".join(bonds) or "none"))
    say_table(("unit", "robots", "shares with"), rows)


def _say_conditions(report: "TopologyReport", mission: "Mission") -> None:
    """Print each of TC1-TC5, whether it holds, and what it means or who violates it."""
    from skyherd.analysis.summary_fields import TC_MEANINGS
    from skyherd.analysis.topology_report import NOT_REQUIRED, required_conditions

    conditions = report.conditions
    holds = (conditions.tc1, conditions.tc2, conditions.tc3, conditions.tc4, conditions.tc5)
    rows = []
    for number, (good, meaning) in enumerate(zip(holds, TC_MEANINGS, strict=True), 1):
        breaches = [breach.what for breach in report.breaches if breach.condition == number]
        broken = "VIOLATED" if number <= required_conditions(mission) else NOT_REQUIRED
        rows.append((f"TC{number}", "holds" if good else broken, "\n".join(breaches) or meaning))
    say_table(("condition", "", ""), rows)


def _say_prediction(report: "TopologyReport", history: "History", *, is_run: bool) -> None:
    """Print the slowest mode and what follows from it: where robots rest, the rate, and the time to 1 %."""
    from skyherd.analysis.foresight import ASSUMPTION
    from skyherd.analysis.topology_report import last_stretch, predicted_time_s, resting_error
    from skyherd.geometry import to_complex

    slowest = report.slowest if report.slowest > MIN_RATE else 0.0
    say(f"slowest mode: λ = {slowest:.4g}, in units of the gain k")
    control = history.mission.scenario.control
    if control.b_th:
        unit = "marker sides" if control.gains == "marker" else "px"
        most = resting_error(slowest, control.b_th)
        say(f"b_th = {control.b_th:g} {unit}: robots may stop up to {most:.3g} {unit} RMS from the shape")
    if control.gains != "marker":
        say("no rate in seconds: with pixel gains it depends on every camera's scale")
        return
    say(f"predicted: shape error falls at {control.k * slowest:.4g} /s in the end")
    start = last_stretch(history).start if is_run else -1
    positions = to_complex(history.positions_m[start])
    time_s = predicted_time_s(report.sets, history.shape, positions, control.k, REACHED_ERROR)
    since_s = history.times_s[start]
    reached = "never" if time_s is None else f"{time_s:.1f} s"
    say(f"predicted: 1 % is reached {reached} after {since_s:.1f} s ({ASSUMPTION})")
    if is_run:
        _say_measured(history, last_stretch(history))


def _say_measured(history: "History", stretch: slice) -> None:
    """Print the rate and the time to 1 % that were measured since the topology last changed."""
    import numpy as np

    from skyherd.analysis.topology_report import measured_rate_ps

    times_s, errors = history.times_s[stretch], history.shape_error[stretch]
    below = np.flatnonzero(errors < REACHED_ERROR)
    took = f"{times_s[below[0]] - times_s[0]:.1f} s" if below.size else "not"
    measured = measured_rate_ps(times_s, errors)
    rate = "too few steps" if measured is None else f"{measured:.4g} /s"
    say(f"measured:  rate {rate}; 1 % was reached {took} after {times_s[0]:.1f} s")


def _say_changes(history: "History") -> None:
    """Print when the topology changed, and what changed."""
    from skyherd.analysis.topology_changes import find_topology_changes

    changes = find_topology_changes(history)
    rows = [(f"{change.time_s:.1f}", change.what) for change in changes[:MAX_CHANGES]]
    if len(changes) > MAX_CHANGES:
        rows.append(("", f"and {len(changes) - MAX_CHANGES} more"))
    say_table(("time, s", "change"), rows)
