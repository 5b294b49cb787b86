"""Outcome of a run in one sentence: what happened and, if the shape was not reached, why.

Terminal, page, video and `summary.json` show the same sentence. It rests on ground truth.
"""

from collections.abc import Callable

import numpy as np

from skyherd.analysis.history import History
from skyherd.analysis.views import MIN_MARKER_PX, Views, views_at
from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.sim.network import connected_parts

RATE_SHARE = 0.2
"""Last part of a run from which the decay of its error is estimated. Chosen: longer than noise and turns."""

MIN_DECAY = 0.02
"""Least share of its error that a run loses over that part and still counts as converging. Chosen."""

MIN_STEPS = 3
"""Least number of steps from which a decay is estimated. Chosen: one more than a line needs."""

MIN_RECALL = 0.5
"""Share of detected markers below which detection is the cause. Chosen."""

MIN_IDLE = 0.1
"""Least share of robots without a goal near the end that counts as a cause. Chosen: above lost messages."""

OFTEN = 0.5
"""Share of robots and steps from which a state counts as the usual one. Chosen."""

AT_LIMIT = 0.99
"""Share of a speed limit from which a wheel counts as saturated. Chosen: above rounding."""

LOOKS = 9
"""Number of instants at which the sides of markers are looked up. Chosen: as a median needs."""

MAX_NAMED = 6
"""Largest number of ids in a sentence; the others are counted. Chosen: one line."""


def held_to_the_end(history: History) -> bool:
    """Return whether the shape error stayed under its goal for `goal.hold_s` up to the last step.

    A run shorter than the hold time has not reached the goal.
    """
    goal, times = history.mission.scenario.goal, history.times_s
    if times[-1] - times[0] < goal.hold_s:
        return False
    last = times >= times[-1] - goal.hold_s - TIME_TOLERANCE_S
    return bool((history.shape_error[last] < goal.shape_error).all())


def reached_s(history: History) -> float | None:
    """Return the time, s, since which the shape error is under its goal; None if not at the end."""
    above = np.flatnonzero(~(history.shape_error < history.mission.scenario.goal.shape_error))
    first = int(above[-1]) + 1 if above.size else 0
    return round(float(history.times_s[first]), 9) if first < history.times_s.size else None


def explain_outcome(history: History, *, complete: bool = True) -> str:
    """Return the outcome of a run in one sentence.

    Args:
        history: the run.
        complete: whether the run reached its planned end.
    """
    scenario, end_s = history.mission.scenario, float(history.times_s[-1])
    held = held_to_the_end(history)
    error = f"{100 * history.shape_error[-1]:.2g} %"
    wanted = f"{100 * scenario.goal.shape_error:.2g} %"
    if not complete:
        formed = "formed and held" if held else "not formed and held"
        return f"Cut short after {end_s:g} of {scenario.duration_s:g} s; until then, the shape was {formed}."
    if held:
        return (
            f"Shape reached after {reached_s(history):.3g} s and held to the end, with an error of {error}."
        )
    if history.shape_error[-1] < scenario.goal.shape_error:
        cause = f"its error is below {wanted}, but not for the last {scenario.goal.hold_s:g} s"
        return f"Shape reached, but not held: {cause}."
    return f"Shape not reached, error {error} instead of {wanted}: {_cause(history)}."


def _cause(history: History) -> str:
    """Return the first cause that applies, from what a unit sees to the motion of the robots."""
    causes: list[Callable[[History], str | None]] = []
    if history.mission.scenario.control.method == "similarity":
        causes = [_unseen, _undetected, _suspected, _out_of_range, _too_high, _uncontrolled]
        causes += [_unshared, _uncovered, _stale]
    causes += [_saturated, _falling, _changed, _brief, _resting, _bent]
    return next(filter(None, (cause(history) for cause in causes)), "the error no longer falls")


def _brief(history: History) -> str | None:
    """State that the run is shorter than the time for which the shape must be held."""
    lasts_s, hold_s = float(np.ptp(history.times_s)), history.mission.scenario.goal.hold_s
    if lasts_s >= hold_s:
        return None
    return f"the run lasts {lasts_s:g} s, and the shape must be held for {hold_s:g} s (goal.hold_s)"


def _crowded(history: History) -> str | None:
    """State that robots stand closer than their markers are wide, so that markers cover each other."""
    side_m = history.mission.scenario.marker.side_m
    places = history.positions_m[_last_part(history.times_s)]
    gaps_m = np.linalg.norm(places[:, :, None] - places[:, None], axis=3)
    gaps_m[:, np.arange(gaps_m.shape[1]), np.arange(gaps_m.shape[1])] = np.inf
    nearest_m = float(np.median(gaps_m.min(axis=(1, 2))))
    if nearest_m >= side_m:
        return None
    return (
        f"robots stand {nearest_m:.2g} m apart with markers {side_m:g} m wide, which cover each other; "
        "enlarge the shape (size)"
    )


def _unseen(history: History) -> str | None:
    """State that no camera saw a robot."""
    if history.whole:
        return None
    return "no robot was ever in view of a unit; check the units' positions and heights"


def _undetected(history: History) -> str | None:
    """State why markers in view were not detected: other ids, small markers or another dictionary."""
    if not history.whole or history.found >= MIN_RECALL * history.whole:
        return None
    if history.false_detections >= MIN_RECALL * history.whole:
        given = f"ids {_named(history.foreign_ids)}, which no robot has" if history.foreign_ids else ""
        return f"the markers in view have {given or 'the ids of other robots'}; check robots.ids"
    marker = history.mission.scenario.marker
    if crowded := _crowded(history):
        return crowded
    share = f"{100 * history.found / history.whole:.0f} % of the markers in view were detected"
    side_px = _usual_side_px(history)
    if side_px < MIN_MARKER_PX:
        few = f"the markers are too small: {side_px:.0f} px wide in the images, so that {share}"
        advice = f"fly lower, zoom in, or enlarge marker.side_m ({MIN_MARKER_PX:.0f} px are needed)"
        return f"{few}; {advice}"
    return (
        f"{share}, though they are {side_px:.0f} px wide; "
        f"their dictionary may not be {marker.dictionary} (marker.dictionary)"
    )


def _suspected(history: History) -> str | None:
    """Name the units that suspect their cameras near the end."""
    units = np.flatnonzero(history.suspected[_last_part(history.times_s)].any(axis=0)).tolist()
    if not units:
        return None
    return f"the images of units {_named(units)} contradicted the robots' commands (camera_check)"


def _usual_side_px(history: History) -> float:
    """Return the median side of the markers in view of any unit, px, at `LOOKS` instants."""
    sides_px = _sides_px(history, np.ones(history.times_s.size, dtype=bool))
    seen = sides_px[np.isfinite(sides_px)]
    return float(np.median(seen)) if seen.size else 0.0


def _sides_by_unit_px(history: History, part: BoolArray) -> Array:
    """Return the median side (U,) of the markers in view of each unit, px; infinite without any in view."""
    seen = [one[np.isfinite(one)] for one in _sides_px(history, part).swapaxes(0, 1)]
    return np.array([np.median(one) if one.size else np.inf for one in seen])


def _sides_px(history: History, part: BoolArray) -> Array:
    """Return the sides (`LOOKS`, U, N) of the markers in view, px, in a part (T,) of a run; NaN elsewhere."""
    steps = np.flatnonzero(part)
    rows = steps[np.linspace(0, steps.size - 1, LOOKS).astype(int)].tolist()
    return np.stack([views_at(history, row).sides_px for row in rows])


def _too_high(history: History) -> str | None:
    """Name the units that controlled no robot near the end, as their markers are too small to be detected."""
    if history.mission.scenario.perception == "ideal":
        return None
    sides_px = _sides_by_unit_px(history, _last_part(history.times_s))
    idle: BoolArray = np.logical_not(history.controlled[_last_part(history.times_s)].any(axis=(0, 2)))
    units = [unit for unit in _alive(history) if idle[unit] and sides_px[unit] < MIN_MARKER_PX]
    if not units:
        return None
    needed_m = (history.heights_m[-1, units] * sides_px[units] / MIN_MARKER_PX).min()
    fly = f"unit {units[0]} flies" if len(units) == 1 else f"units {_named(units)} fly"
    small = f"markers {sides_px[units].max():.2g} px wide are too small to be detected"
    advice = f"fly at {needed_m:.3g} m or lower, zoom in, or enlarge marker.side_m"
    return f"{fly} too high to control a robot: {small}; {advice} ({MIN_MARKER_PX:.0f} px are needed)"


def _out_of_range(history: History) -> str | None:
    """State which units cannot hear each other at the end, if they negotiate."""
    scenario = history.mission.scenario
    range_m, alive = scenario.network.range_m, _alive(history)
    if range_m is None or scenario.selection.kind == "radius":
        return None
    places_m = history.unit_positions_m[-1, alive]
    hears: BoolArray = np.linalg.norm(places_m[:, None] - places_m, axis=2) <= range_m
    parts = connected_parts([np.flatnonzero(row).tolist() for row in hears])
    if len(parts) == 1 and (scenario.network.relay or hears.all()):
        return None
    names = " | ".join(_named([alive[unit] for unit in part]) for part in parts)
    need = f"the radio reaches {range_m:g} m (network.range_m)"
    return f"{need}, which cuts the units into groups without contact: {names}" if len(parts) > 1 else need


def _uncontrolled(history: History) -> str | None:
    """State which robots no unit controls, since when (TC2), and why."""
    controlled: BoolArray = np.asarray(history.controlled.any(axis=1))
    lost = np.flatnonzero(~controlled[-1])
    if not lost.size:
        return None
    first = max((int(np.flatnonzero(row)[-1]) + 1 for row in controlled.T[lost] if row.any()), default=0)
    since = f" since {history.times_s[first]:.3g} s" if first else ""
    return f"no unit controls {robots_of(history, lost)}{since} (TC2): {_out_of_radius(history, lost)}"


def _out_of_radius(history: History, lost: IntArray) -> str:
    """Return why robots, rows (M,), are inside no safety radius: the radius, low cameras or few units."""
    scenario, alive = history.mission.scenario, _alive(history)
    if not alive:
        return "all units are dead"
    views = _only(views_at(history, -1), alive)
    radius = scenario.selection.radius
    radii = views.radii[:, lost]
    if (radii.min(axis=0) <= radius).all():
        return "inside a safety radius, but no unit took control"
    if views.in_view[:, lost].any(axis=0).all():
        return (
            f"in view, but outside the safety radius of {radius:g} (selection.radius); "
            "enlarge it or fly higher"
        )
    needed = radii.min(axis=0).max() / radius
    nearest = int(radii[:, radii.min(axis=0).argmax()].argmin())
    unit, height_m = alive[nearest], float(history.heights_m[-1, alive[nearest]])
    limit_m = scenario.autopilot.max_height_m
    if height_m * needed > limit_m:
        return f"too few units, since autopilot.max_height_m = {limit_m:g} is too low to see them all"
    camera = history.mission.cameras_at(float(history.times_s[-1]))[unit]
    focal_px = camera.focal_px * float(history.zooms[-1, unit])
    if (side_px := focal_px * scenario.marker.side_m / (height_m * needed)) < MIN_MARKER_PX:
        need_m = f"{height_m * needed:.3g} m"
        return f"too few units, since from {need_m}, where all are in view, markers are {side_px:.2g} px wide"
    return f"unit {unit} is too low at {height_m:.3g} m; about {height_m * needed:.3g} m are needed"


def _unshared(history: History) -> str | None:
    """State which units share no pair of robots with the others at the end (TC1), and why."""
    alive = _alive(history)
    sets = history.controlled[-1].astype(int)
    linked = sets @ sets.T >= 2
    reached = set(alive[:1])
    while more := {int(j) for i in reached for j in np.flatnonzero(linked[i])} - reached:
        reached |= more
    apart = sorted(set(alive) - reached)
    if not apart:
        return None
    views, radius = views_at(history, -1), history.mission.scenario.selection.radius
    seen = (views.in_view[apart][:, None] & views.in_view[sorted(reached)]).sum(axis=2).max()
    few = "fewer than two robots are in view of both: their views do not overlap enough (TC1)"
    cut = (
        f"{seen} robots are in view of both, but the safety radius of {radius:g} cuts them (selection.radius)"
    )
    who = "unit" if len(apart) == 1 else "units"
    return f"{who} {_named(apart)} and unit {alive[0]} share no pair of robots: {cut if seen >= 2 else few}"


def _uncovered(history: History) -> str | None:
    """State how many controlled robots have no goal on average, since units that patrol do not see them."""
    if all(unit.flight.kind == "hover" for unit in history.mission.scenario.units):
        return None
    idle = history.controlled.any(axis=1) & ~history.commanded
    unseen = ~views_at(history, -1).in_view.any(axis=0)
    idle = idle[_last_part(history.times_s)]
    if idle.mean() < MIN_IDLE or (idle[-1] & unseen).sum() < OFTEN * idle[-1].sum():
        return None
    many = f"on average {idle.sum(axis=1).mean():.1f} of {history.ids.size} robots"
    advice = "a higher ceiling, another unit or a smaller shape is needed"
    return f"{many} are outside the views of their units; {advice}"


def _stale(history: History) -> str | None:
    """State which robots stand still because their goals are stale, and why."""
    stale = np.flatnonzero(~history.commanded[_last_part(history.times_s)].any(axis=0))
    if stale.size and not views_at(history, -1).in_view[:, stale].any():
        return f"{robots_of(history, stale)} left the images: {_out_of_radius(history, stale)}"
    share = 1 - float(history.commanded[_last_part(history.times_s)].mean())
    if share < OFTEN:
        return None
    timeout_s = history.mission.scenario.robots.timeout_s
    return f"robots had no fresh goal in {100 * share:.0f} % of the time (robots.timeout_s = {timeout_s:g})"


def _saturated(history: History) -> str | None:
    """State that the robots drive at a limit of their wheels, and the time that they still need."""
    robots, last = history.mission.scenario.robots, _judged_part(history)
    if last.sum() < MIN_STEPS and _changed(history):
        return None
    speeds = np.abs(history.v_mps)[last] / robots.max_speed_mps
    turns = np.abs(history.omega_radps)[last] / robots.max_turn_radps
    share, limit = max(
        (float((speeds >= AT_LIMIT).mean()), f"speed limit of {robots.max_speed_mps:g} m/s (max_speed_mps)"),
        (
            float((turns >= AT_LIMIT).mean()),
            f"turn limit of {robots.max_turn_radps:g} rad/s (max_turn_radps)",
        ),
    )
    if share < OFTEN:
        return None
    goal, errors = history.mission.scenario.goal, history.shape_error[last]
    slope_ps = -float(np.polyfit(history.times_s[last], errors, 1)[0]) if errors.size > 1 else 0.0
    more_s = (errors[-1] - goal.shape_error) / slope_ps + goal.hold_s if slope_ps > 0 else np.inf
    more = f"; at least {more_s:.0f} s more are needed" if np.isfinite(more_s) else ""
    return f"the wheels are at their {limit} in {100 * share:.0f} % of the time{more}"


def _falling(history: History) -> str | None:
    """State the rate of a falling error, and the time until it would reach the goal."""
    rate_ps, goal = _decay_ps(history), history.mission.scenario.goal
    if rate_ps is None:
        return None
    more_s = max(np.log(history.shape_error[-1] / goal.shape_error) / rate_ps, 0.0) + goal.hold_s
    falls = f"the error still falls by {100 * rate_ps:.1f} % a second"
    return f"the run is too short, since {falls}; about {more_s:.0f} s more are needed"


def _changed(history: History) -> str | None:
    """State that the shape changed so late that the decay of the error cannot be judged."""
    changed_s, last = _last_change_s(history), _last_part(history.times_s)
    if changed_s is None or changed_s < history.times_s[last][0]:
        return None
    left_s = max(float(history.times_s[-1]) - changed_s, 0.0)
    return f"the run is too short, since the shape changed {left_s:.3g} s before the end"


def _resting(history: History) -> str | None:
    """State that the robots stopped at their threshold."""
    control = history.mission.scenario.control
    if not control.b_th or np.abs(history.v_mps[_last_part(history.times_s)]).any():
        return None
    unit = "marker sides" if control.gains == "marker" else "px"
    return f"the robots stopped within {control.b_th:g} {unit} of their goals (control.b_th)"


def _bent(history: History) -> str | None:
    """State that tilted or distorting cameras are not rectified."""
    scenario = history.mission.scenario
    if scenario.control.rectify or all(unit.ideal for unit in scenario.units):
        return None
    return "the cameras are tilted or distort, and control.rectify is off"


def _last_part(times_s: Array) -> BoolArray:
    """Return the mask (T,) of the last `RATE_SHARE` of a run."""
    return np.asarray(times_s >= times_s[-1] - RATE_SHARE * (times_s[-1] - times_s[0]))


def _last_change_s(history: History) -> float | None:
    """Return the time, s, of the last change of shape in a run; None if it has one shape."""
    end_s = float(history.times_s[-1]) + TIME_TOLERANCE_S
    return max((at_s for at_s, _ in history.mission.later if at_s <= end_s), default=None)


def _judged_part(history: History) -> BoolArray:
    """Return the mask (T,) of the last part of a run, without the steps before the last change of shape."""
    last, changed_s = _last_part(history.times_s), _last_change_s(history)
    return last if changed_s is None else last & (history.times_s >= changed_s - TIME_TOLERANCE_S)


def _decay_ps(history: History) -> float | None:
    """Return the exponential decay rate of the error over the judged part; None if it is not falling."""
    times_s, errors = history.times_s, history.shape_error
    last = _judged_part(history) & np.isfinite(errors) & (errors > 0)
    if last.sum() < MIN_STEPS:
        return None
    rate_ps = -float(np.polyfit(times_s[last], np.log(errors[last]), 1)[0])
    return rate_ps if rate_ps * float(np.ptp(times_s[last])) > MIN_DECAY else None


def _alive(history: History) -> list[int]:
    """Return the units that are not in an outage at the end."""
    scenario = history.mission.scenario
    dead = scenario.dead_units(float(history.times_s[-1]))
    return [unit for unit in range(len(scenario.units)) if unit not in dead]


def _only(views: Views, units: list[int]) -> Views:
    """Return the views of some units."""
    return Views(views.in_view[units], views.sides_px[units], views.radii[units])


def robots_of(history: History, rows: IntArray) -> str:
    """Name the robots of some rows (M,) of a run."""
    return f"robot{'s' if rows.size > 1 else ''} {_named(history.ids[rows].tolist())}"


def _named(numbers: list[int]) -> str:
    """Name some numbers, and count the others."""
    shown = ", ".join(map(str, numbers[:MAX_NAMED]))
    return shown if len(numbers) <= MAX_NAMED else f"{shown} and {len(numbers) - MAX_NAMED} more"
