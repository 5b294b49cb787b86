"""Warnings about a scenario before it runs: views, marker sizes and duration at its start."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from skyherd.analysis.history import History, make_history
from skyherd.analysis.radio_check import foresee_radio
from skyherd.analysis.topology_report import judge_topology, predicted_time_s
from skyherd.analysis.verdict import robots_of
from skyherd.analysis.views import MIN_MARKER_PX, views_at
from skyherd.datasets import Mission, SizeModel
from skyherd.geometry import IntArray, to_complex
from skyherd.loop import Step, run_steps

ASSUMPTION = "linear model: this topology, robots that drive straight, no speed limit"
"""Assumption of predicted times."""


def deploy(mission: Mission) -> tuple[History, bool]:
    """Run a mission on exact detections until its topology is in place.

    Returns:
        the history, and whether a tree of units was completed; True without a tree.
    """
    exact = replace(mission, scenario=mission.scenario.model_copy(update={"perception": "ideal"}))
    steps: list[Step] = []
    for step in run_steps(exact):
        steps.append(step)
        trees = [frame.decision.report.tree for frame in step.frames.values()]
        if any(tree is None or tree.ready for tree in trees):
            return make_history(exact, steps), True
    return make_history(exact, steps), False


def living_sets(history: History) -> dict[int, IntArray]:
    """Return the ids of the robots that each living unit controls at the end of a history."""
    tree = history.trees[-1]
    dead = frozenset[int]() if tree is None else tree.dead
    return {unit: history.ids[mine] for unit, mine in enumerate(history.controlled[-1]) if unit not in dead}


def foresee(mission: Mission) -> list[str]:
    """Return warnings about a scenario, each a sentence without a full stop.

    They name robots outside all views at the start, and markers narrower than `MIN_MARKER_PX`. They also name
    missing radio links, links that may break, and a duration below the predicted time.
    """
    history, is_ready = deploy(mission)
    duration = _of_duration(history) if is_ready else []
    return [*_of_views(history), *_of_size(mission), *foresee_radio(mission), *duration]


def _of_views(history: History) -> Iterator[str]:
    """Yield warnings about the images at the start."""
    views = views_at(history, 0)
    if (hidden := np.flatnonzero(~views.in_view.any(axis=0))).size:
        yield f"{robots_of(history, hidden)} in no view at the start; move the units, or raise height_m"
    for unit, sides_px in enumerate(views.sides_px):
        seen = sides_px[np.isfinite(sides_px)]
        if seen.size and (side_px := float(np.median(seen))) < MIN_MARKER_PX:
            yield (
                f"unit {unit} sees markers {side_px:.1f} px wide; at least {MIN_MARKER_PX:g} px are needed: "
                "lower height_m, or enlarge marker.side_m"
            )


def _of_size(mission: Mission) -> Iterator[str]:
    """Yield a warning if the finished shape puts markers on top of each other."""
    spacing = mission.scenario.size.spacing_sides
    if spacing is not None and spacing < 1:
        yield (
            f"size.spacing_sides = {spacing:g} puts markers on top of each other; at least 1 is needed, and "
            "more for their white margins"
        )


def _of_duration(history: History) -> Iterator[str]:
    """Yield a warning if the duration is below the predicted time to the first shape and its hold time."""
    mission, scenario = history.mission, history.mission.scenario
    control, goal = scenario.control, scenario.goal
    if control.method != "similarity" or control.gains != "marker" or scenario.size != SizeModel():
        return
    if mission.later or not history.conditions[-1, :2].all():
        return
    report = judge_topology(living_sets(history), history.shape)
    places = to_complex(history.positions_m[-1])
    time_s = predicted_time_s(report.sets, history.shape, places, control.k, goal.shape_error)
    needed_s = float(history.times_s[-1]) + (time_s or 0.0) + goal.hold_s
    if needed_s > scenario.duration_s:
        yield (
            f"duration_s = {scenario.duration_s:g} is below the predicted {needed_s:.0f} s, "
            f"goal.hold_s included ({ASSUMPTION})"
        )
