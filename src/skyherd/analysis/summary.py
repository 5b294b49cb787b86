"""Numerical summary of a run: the content of `summary.json`.

`uncommanded_robot_s` is the total time for which robots stood still because their goal was stale, summed over
all robots.
"""

from typing import Any

import numpy as np
from scipy.spatial.distance import pdist

from skyherd.analysis.dwell_time import estimate_dwell_time
from skyherd.analysis.history import History
from skyherd.analysis.shortest_paths import shortest_path
from skyherd.analysis.verdict import explain_outcome, held_to_the_end, reached_s
from skyherd.datasets import Scenario
from skyherd.geometry import ComplexArray, IntArray, to_complex, to_points
from skyherd.messages import TIME_TOLERANCE_S


def summarize(history: History, wall_s: float | None) -> dict[str, Any]:
    """Make the summary of a run: plain values by key, ready for JSON.

    Keys carry their units. `shape_error` is the RMS distance to the best-fitting similarity of the template
    over the formation's RMS radius. `scale` is in metres per template unit. Both are ground truth. Violations
    count from `ready_s`, when the tree of units is complete, or from the start if it never is.
    `min_separation_m` is the distance between robot centres, `min_gap_m` that between bodies, including
    obstacles. Both, and collisions, are evaluated at the steps.

    Args:
        history: the run.
        wall_s: wall time of the run; None for an incomplete run, whose rates then are None.
    """
    scenario = history.mission.scenario
    return {
        "scenario": scenario.name,
        "seed": scenario.seed,
        "perception": scenario.perception,
        **_course(history, wall_s),
        **_shape(history),
        "detection_recall": history.found / history.whole if history.whole else None,
        "false_detections": history.false_detections,
        **_topology(history),
        **_tree(history),
        **_robots(history),
    }


def _course(history: History, wall_s: float | None) -> dict[str, Any]:
    """Return the duration of the run and its speed."""
    steps, simulated_s = int(history.times_s.size), float(history.times_s[-1])

    def per_wall(amount: float) -> float | None:
        return None if not wall_s else amount / wall_s

    return {
        "converged": held_to_the_end(history),
        "reached_s": reached_s(history),
        "verdict": explain_outcome(history, complete=wall_s is not None),
        "complete": wall_s is not None,
        "simulated_s": simulated_s,
        "real_time_factor": per_wall(simulated_s),
        "wall_s": wall_s,
        "steps": steps,
        "loop_steps_per_s": per_wall(steps),
        "frames": history.frames,
        "frames_per_s": per_wall(history.frames),
    }


def _shape(history: History) -> dict[str, Any]:
    """Return the values of the formed shape."""
    errors_m = history.goal_errors_m
    return {
        "shape_error": float(history.shape_error[-1]),
        "goal_error_m": float(np.nanmax(errors_m)) if np.isfinite(errors_m).any() else None,
        "scale": float(history.shape_scale[-1]),
        "rotation_rad": float(history.shape_rotation_rad[-1]),
        "V_start": float(history.V[history.ready_row or 0]),
        "V_end": float(history.V[-1]),
    }


def _topology(history: History) -> dict[str, Any]:
    """Return the number of set changes, and the time for which each of TC1-TC5 was violated."""
    step_s = history.mission.scenario.step_s
    counted = history.conditions[history.ready_row or 0 : -1]
    violated_s = (~counted).sum(axis=0) * step_s
    switches = (history.controlled[1:] != history.controlled[:-1]).any(axis=(1, 2))
    return {
        "topology_changes": int(switches.sum()),
        "p_violation_s": float((~counted.all(axis=1)).sum() * step_s),
        **{f"tc{number}_violation_s": float(violated_s[number - 1]) for number in range(1, 6)},
        **_dwell(history),
    }


def _dwell(history: History) -> dict[str, float | None]:
    """Return the dwell times and the requirement of Proposition 1 (`analysis/dwell_time.py`)."""
    dwell = estimate_dwell_time(history)
    return {
        "dwell_min_s": dwell.min_s,
        "dwell_mean_s": dwell.mean_s,
        "switch_ratio": dwell.switch_ratio,
        "decay_rate_ps": dwell.decay_ps,
        "dwell_needed_s": dwell.needed_s,
        "dwell_bound_s": dwell.bound_s,
    }


def _robots(history: History) -> dict[str, Any]:
    """Return the positions of the robots and their least distance."""
    roles = np.concatenate([np.arange(history.ids.size)[None], history.roles])
    travelled = np.linalg.norm(np.diff(history.positions_m, axis=0), axis=2).sum()
    collisions, min_gap_m = _contacts(history)
    return {
        "uncommanded_robot_s": float((~history.commanded[:-1]).sum() * history.mission.scenario.step_s),
        "min_separation_m": float(history.min_separation_m.min()),
        "min_gap_m": min_gap_m,
        "collisions": collisions,
        "role_exchanges": int((roles[1:] != roles[:-1]).any(axis=1).sum()),
        "path_length_m": float(travelled),
        "shortest_path_m": _shortest_path_m(history),
        "final_positions_m": {
            str(robot): position.tolist()
            for robot, position in zip(history.ids.tolist(), history.positions_m[-1], strict=True)
        },
    }


def _contacts(history: History) -> tuple[int, float]:
    """Count the onsets of body overlaps, including the start, and find the least gap."""
    bodies = history.mission.bodies
    before, begun, min_m = np.zeros(1, dtype=bool), 0, np.inf
    for positions_m in history.positions_m:
        gaps_m = bodies.gaps_m(positions_m)
        begun += int(((gaps_m < 0) & ~before).sum())
        before, min_m = gaps_m < 0, min(min_m, float(gaps_m.min()))
    return begun, min_m


def _shortest_path_m(history: History) -> float:
    """Return the straight lines from the start into the shape at the best allowed pose and size.

    Robots that may exchange roles also have the best assignment. With several shapes, each begins at the
    robots' positions when it became active, and the lengths add up.
    """
    mission = history.mission
    classes: IntArray | None = np.arange(history.ids.size)
    if mission.scenario.roles.exchange:
        given = mission.scenario.roles.classes
        classes = None if given is None else np.array(given)
    length_m = 0.0
    for from_s in (0.0, *(at_s for at_s, _ in mission.later)):
        row = int(np.searchsorted(history.times_s, from_s - TIME_TOLERANCE_S))
        if row == history.times_s.size:
            break
        template = mission.schedule.at(from_s).points_of(history.ids).conj()
        start, spacing_m = to_complex(history.positions_m[row]), _spacing_m(mission.scenario, template)
        length_m += shortest_path(template, start, classes=classes, spacing=spacing_m).length
    return length_m


def _spacing_m(scenario: Scenario, template: ComplexArray) -> tuple[float, float]:
    """Return the bounds on the distance between the shape's two nearest robots."""
    size, side_m = scenario.size, scenario.marker.side_m
    if size.unit_m is not None:
        return (size.unit_m * float(pdist(to_points(template)).min()),) * 2
    if size.spacing_sides is not None:
        return (size.spacing_sides * side_m,) * 2
    return size.min_spacing_sides * side_m, np.inf


def _tree(history: History) -> dict[str, Any]:
    """Return the final state of the tree of units; empty if units select robots by safety radius alone."""
    tree, ready = history.trees[-1], history.ready_row
    if tree is None:
        return {}
    alone = history.ids[~history.controlled[-1].any(axis=0)].tolist()
    return {
        "ready_s": None if ready is None else float(history.times_s[ready]),
        "missing_robots": sorted(tree.missing_ids.union(alone)),
        "unjoined_units": sorted(tree.unjoined),
    }
