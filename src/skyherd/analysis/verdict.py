"""Reason why a run did not reach its shape, in one sentence."""

import numpy as np

from skyherd.analysis.history import History
from skyherd.geometry import Array

RATE_SHARE = 0.2
"""Last part of a run from which the decay of its error is estimated. Chosen: longer than noise and turns."""

MIN_DECAY = 0.02
"""Least share of its error that a run loses over that part and still counts as converging. Chosen."""


def explain_failure(history: History) -> str:
    """Return why the shape was not reached: the first cause that applies, without a full stop.

    The causes are, in this order: no robot is detected, robots that no unit ever controlled, units without a
    shared pair of robots, and an error that still falls.
    """
    goal = history.mission.scenario.goal
    error = f"shape error {100 * history.shape_error[-1]:.2g} % instead of {100 * goal.shape_error:.2g} %"
    has_units = history.mission.scenario.control.method == "similarity"
    cause = (has_units and (_unseen(history) or _unshared(history))) or _falling(history)
    return f"{error}: {cause or 'it no longer falls'}"


def _unseen(history: History) -> str | None:
    """Name the robots that no unit ever controlled."""
    never = history.ids[~history.controlled.any(axis=(0, 1))]
    if never.size and history.whole and not history.found:
        return "no marker was detected, though markers are in view; check their size and dictionary"
    if never.size == history.ids.size:
        few = "fewer than two robots were ever inside a unit's safety radius"
        return few if history.whole else "no robot was ever in view of a unit"
    if never.size:
        return f"no unit ever controlled robots {', '.join(map(str, never.tolist()))}"
    return None


def _unshared(history: History) -> str | None:
    """Say which units share no pair of robots with the others at the end."""
    end_s, units = float(history.times_s[-1]), history.mission.scenario.units
    alive = [
        unit
        for unit, model in enumerate(units)
        if not any(start_s <= end_s < stop_s for start_s, stop_s in model.outages)
    ]
    sets = history.controlled[-1].astype(int)
    linked = sets @ sets.T >= 2
    reached = set(alive[:1])
    while more := {int(j) for i in reached for j in np.flatnonzero(linked[i])} - reached:
        reached |= more
    apart = sorted(set(alive) - reached)
    if not apart:
        return None
    return f"units {', '.join(map(str, apart))} share no pair of robots with unit {alive[0]} or its partners"


def _falling(history: History) -> str | None:
    """State the rate of a falling error, and the time until it would reach the goal."""
    rate_ps = _decay_ps(history.times_s, history.shape_error)
    goal = history.mission.scenario.goal
    if rate_ps is None:
        return None
    more_s = max(np.log(history.shape_error[-1] / goal.shape_error) / rate_ps, 0.0) + goal.hold_s
    return f"the error still falls by {100 * rate_ps:.1f} % a second; about {more_s:.0f} s more are needed"


def _decay_ps(times_s: Array, errors: Array) -> float | None:
    """Return the exponential decay rate of the error over the last part of a run; None if it has stopped."""
    last = times_s >= times_s[-1] - RATE_SHARE * (times_s[-1] - times_s[0])
    last &= np.isfinite(errors) & (errors > 0)
    if last.sum() < 3:
        return None
    rate_ps = -float(np.polyfit(times_s[last], np.log(errors[last]), 1)[0])
    return rate_ps if rate_ps * float(np.ptp(times_s[last])) > MIN_DECAY else None
