"""`skyherd topology`: who controls whom, which of TC1-TC5 hold and why not, and how fast that converges."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from skyherd.analysis.history import History, make_history
from skyherd.analysis.summary_fields import TC_MEANINGS
from skyherd.analysis.topology_changes import find_topology_changes
from skyherd.analysis.topology_report import (
    TopologyReport,
    judge_topology,
    last_stretch,
    measured_rate_ps,
    predicted_time_s,
    resting_error,
)
from skyherd.cli.console import out, warn
from skyherd.datasets import Mission, load_mission
from skyherd.errors import InputError
from skyherd.files.atomic import write_whole
from skyherd.geometry import IntArray, to_complex
from skyherd.loop import Step, run_steps
from skyherd.plots.graph import draw_graph
from skyherd.plots.style import DPI, drawing_style
from skyherd.recording.reader import read_recording
from skyherd.runner import RECORDING

PICTURES = (".png", ".svg")
MOST_SWITCHES = 60


def topology(
    source: Annotated[
        str, typer.Argument(metavar="FILE|RUN", help="A scenario, a run's folder, or its run.mcap.")
    ],
    picture: Annotated[
        Path | None,
        typer.Option("--out", help="PNG or SVG; topology.png in the run's folder, or NAME-topology.png."),
    ] = None,
) -> int:
    """Show a scenario's topology after deployment, or a run's at its end; exit code 1 outside TC1-TC5."""
    history, default, is_run = _open(source)
    path = picture or default
    if path.suffix not in PICTURES:
        raise InputError(str(path), "no kind of picture", f"a name that ends in {' or '.join(PICTURES)}")
    report = judge_topology(_living_sets(history), history.shape)
    _tell_graph(report, history)
    _tell_conditions(report)
    _tell_rates(report, history, is_run=is_run)
    if is_run:
        _tell_switches(history)
    with drawing_style():
        figure = draw_graph(history)
        figure.axes[0].set_title(_verdict(report, history), fontsize=10, loc="left")
        write_whole(path, lambda part: figure.savefig(part, format=path.suffix[1:], dpi=DPI))
    out.print(f"see {path}", markup=False)
    return 0 if report.conditions.in_p else 1


def _open(source: str) -> tuple[History, Path, bool]:
    """The history to judge, where its picture goes, and whether it is of a run."""
    path = Path(source)
    if path.is_dir():
        if not (path / RECORDING).is_file():
            raise InputError(
                source, f"no {RECORDING} in it", "a scenario, or the output folder of `skyherd run`"
            )
        path = path / RECORDING
    if path.suffix == ".mcap":
        recording = read_recording(path)
        return make_history(recording.mission, recording.steps), path.with_name("topology.png"), True
    mission = load_mission(source, ["perception=ideal"])
    return _deploy(mission), Path(f"{mission.scenario.name}-topology.png"), False


def _deploy(mission: Mission) -> History:
    """Run a mission until its topology is in place."""
    steps: list[Step] = []
    for step in run_steps(mission):
        steps.append(step)
        words = [frame.decision.report.tree for frame in step.frames.values()]
        if any(word is None or word.ready for word in words):
            return make_history(mission, steps)
    warn(f"the tree of units was not complete after {step.time_s:g} s; this is how far it came")
    return make_history(mission, steps)


def _living_sets(history: History) -> dict[int, IntArray]:
    tree = history.trees[-1]
    dead = frozenset[int]() if tree is None else tree.dead
    return {unit: history.ids[mine] for unit, mine in enumerate(history.controlled[-1]) if unit not in dead}


def _verdict(report: TopologyReport, history: History) -> str:
    """The picture's title: when it was, and what the conditions say."""
    broken = sorted({breach.condition for breach in report.breaches})
    said = f"violated: {', '.join(f'TC{number}' for number in broken)}" if broken else "TC1-TC5 hold"
    at = f"{history.mission.scenario.name} at {history.times_s[-1]:.1f} s"
    return f"{at} · {said} · slowest mode λ = {report.slowest:.3g}"


def _tell_graph(report: TopologyReport, history: History) -> None:
    scenario = history.mission.scenario
    out.print(f"{scenario.name} at {history.times_s[-1]:.1f} s", markup=False, style="bold")
    table = Table("unit", "robots", "shares with", box=None, header_style="bold")
    for unit, robots in report.sets.items():
        bonds = [
            f"{k if j == unit else j}: {', '.join(map(str, common))}"
            for (j, k), common in report.shared.items()
            if unit in (j, k)
        ]
        table.add_row(str(unit), str(robots.size), "   ".join(bonds) or "nobody")
    out.print(table)


def _tell_conditions(report: TopologyReport) -> None:
    table = Table("condition", "", "", box=None, header_style="bold")
    conditions = report.conditions
    holds = (conditions.tc1, conditions.tc2, conditions.tc3, conditions.tc4, conditions.tc5)
    for number, (good, meaning) in enumerate(zip(holds, TC_MEANINGS, strict=True), 1):
        breaches = [breach.what for breach in report.breaches if breach.condition == number]
        table.add_row(f"TC{number}", "holds" if good else "VIOLATED", "\n".join(breaches) or meaning)
    out.print(table)


def _tell_rates(report: TopologyReport, history: History, *, is_run: bool) -> None:
    """Predicted rate and time to 1 %, and of a run what was measured."""
    scenario = history.mission.scenario
    slowest = report.slowest if report.slowest > 1e-9 else 0.0
    out.print(f"slowest mode: λ = {slowest:.4g}, in units of the gain k", markup=False)
    control = scenario.control
    if control.b_th:
        unit = "marker sides" if control.gains == "marker" else "px"
        most = resting_error(slowest, control.b_th)
        out.print(
            f"b_th = {control.b_th:g} {unit}: robots may stop up to {most:.3g} {unit} RMS from the shape"
        )
    if scenario.control.gains != "marker":
        out.print("no rate in seconds: with pixel gains it depends on every camera's scale", markup=False)
        return
    gain_ps = scenario.control.k
    predicted = gain_ps * slowest
    stretch = last_stretch(history)
    times_s, errors = history.times_s[stretch], history.shape_error[stretch]
    out.print(f"predicted: shape error falls at {predicted:.4g} /s in the end", markup=False)
    start = stretch.start if is_run else -1
    time_s = predicted_time_s(
        report.sets,
        history.shape,
        to_complex(history.positions_m[start]),
        gain_ps,
        0.01,
    )
    since = history.times_s[start]
    reached = "never" if time_s is None else f"{time_s:.1f} s"
    out.print(f"predicted: 1 % is reached {reached} after {since:.1f} s, with this topology", markup=False)
    if not is_run:
        return
    below = np.flatnonzero(errors < 0.01)
    took = f"{times_s[below[0]] - since:.1f} s" if below.size else "not"
    measured = measured_rate_ps(times_s, errors)
    rate = "too few steps to tell" if measured is None else f"{measured:.4g} /s"
    out.print(f"measured:  rate {rate}; 1 % was reached {took} after {since:.1f} s", markup=False)


def _tell_switches(history: History) -> None:
    switches = find_topology_changes(history)
    table = Table("time, s", "switch", box=None, header_style="bold")
    for switch in switches[:MOST_SWITCHES]:
        table.add_row(f"{switch.time_s:.1f}", switch.what)
    if len(switches) > MOST_SWITCHES:
        table.add_row("", f"and {len(switches) - MOST_SWITCHES} more")
    out.print(table)
