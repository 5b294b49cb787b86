"""How long a run's topologies lasted, beside the average dwell time τ_d of the paper's Proposition 1.

The proposition says that a finite τ_d exists, and rests on two things: V_p <= μ V_q for any two topologies p
and q at the same positions (eq. 15), and that V_p falls while p lasts. If it does so at a rate λ_0 or faster,
then N changes within a time T leave

    V(T) <= μ^N exp(-λ_0 T) V(0),    which vanishes if T / N > τ_d = ln μ / λ_0

(Hespanha and Morse 1999, with λ_0 for their 2 λ_0). A τ_d is sufficient and not necessary: V as one sum is
not the only function that can show convergence, and `docs/topology.md` has one that falls at every change.

Two pairs of μ and λ_0 are had here, and neither is a proof for the run's robots:

- *As measured*: the greatest V after over V before, at the changes that were, and the least rate at which V
  fell between two. μ of eq. 15 is over all positions, so that this one is an estimate from below, of the run
  that was; λ_0 has turning robots, limits of speed, delays and noise in it.
- *Of the linear model* `dp/dt = -k L p`: μ is the greatest eigenvalue of L_q against L_p over all positions,
  a bound for the changes that were, and V falls at 2 k λ_3(L_p) at least. A bound for robots that drive
  straight to their goals at one gain; robots at their limit of speed are slower.

Counted are the steps from when robots may move at which the shape error is not below its goal: in the shape
noise and the stop threshold decide what V does. Topologies without TC1 or TC2 have no μ, since V is 0 for
wrong shapes too: changes from and to them count as changes and not in μ. New roles and new shapes end a
stretch of V; they are no changes of the topology.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from skyherd.analysis.history import History
from skyherd.control import laplacian
from skyherd.geometry import BoolArray, ComplexArray, to_complex
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.sim.truth_metrics import total_cost

MIN_RATE = 1e-9
"""A third eigenvalue of L below this is zero, and the shape free. Derived: above rounding, 1e-15 a robot."""

DIGITS = 12
"""Significant digits that are told. Chosen: sums over arrays that lie elsewhere in memory differ in the
sixteenth, and a recording that is read again is to have the same summary."""

MAX_ROBOTS = 200
"""Most robots of which the bound is worked out. Chosen: the eigenvalues of a change then take a hundredth of
a second, and their time grows with the third power."""


@dataclass(frozen=True)
class DwellTime:
    """The dwell times of a run and what Proposition 1 asks for; see the module for how it is had.

    All of them are None for a run in which V never fell, or no robot ever might move.

    Attributes:
        min_s: least time between two changes of the topology; None with fewer than two.
        mean_s: the time counted over the number of changes in it; None without any.
        switch_ratio: μ as measured, V after over V before at the change that raised it most; below 1 if V
            fell at all of them, None without a change between topologies that satisfy TC1 and TC2.
        decay_ps: λ_0 as measured, 1/s; negative if V rose between two changes.
        needed_s: τ_d of both, an estimate. 0 if V rose at no change: then any dwell time is enough. None
            without a change, where Theorem 1 holds and nothing is asked, or if V did not fall somewhere.
        bound_s: τ_d of the linear model, for any positions. None without a change, for gains in pixels or
            laws other than the paper's, of which no rate is known, and for more than `MAX_ROBOTS`.
    """

    min_s: float | None = None
    mean_s: float | None = None
    switch_ratio: float | None = None
    decay_ps: float | None = None
    needed_s: float | None = None
    bound_s: float | None = None


@dataclass(frozen=True)
class _Stretch:
    """Steps `first` to `last` with the same sets, roles and shape, but that others may come with the last.

    Attributes:
        V_last: V at the last step by the sets, roles and shape of the first.
        switches: whether it ends with a change of the sets alone, and μ exists for it.
        has_kernel: whether TC1 and TC2 hold, so that V vanishes in the shape only.
    """

    first: int
    last: int
    V_last: float
    switches: bool
    has_kernel: bool


def estimate_dwell_time(history: History) -> DwellTime:
    """The dwell times of a run beside what Proposition 1 asks for."""
    stretches = list(_stretches(history))
    switched = np.flatnonzero(_change(history.controlled))
    counted = _counted(history)
    here = switched[counted[switched]]
    between_s = np.diff(history.times_s[switched])[counted[switched[1:]] & counted[switched[:-1]]]
    counted_s = float(counted[:-1].sum()) * history.mission.scenario.step_s
    rates = [_rate_ps(history, stretch) for stretch in stretches if stretch.has_kernel]
    at = [stretch for stretch in stretches if stretch.switches]
    ratio = max((float(history.V[one.last]) / one.V_last for one in at), default=None)
    decay_ps = min(rates, default=None)
    return DwellTime(
        min_s=float(between_s.min()) if between_s.size else None,
        mean_s=counted_s / here.size if here.size else None,
        switch_ratio=_rounded(ratio),
        decay_ps=_rounded(decay_ps),
        needed_s=_rounded(_dwell_s(ratio, decay_ps)),
        bound_s=_rounded(_dwell_s(*_of_linear_model(history, stretches))),
    )


def _rounded(value: float | None) -> float | None:
    """The value to `DIGITS`."""
    return None if value is None else float(f"{value:.{DIGITS}g}")


def _dwell_s(ratio: float | None, rate_ps: float | None) -> float | None:
    """The dwell time ln μ / λ_0, 0 for μ below 1; None if either is not known, or V does not fall."""
    if ratio is None or rate_ps is None or rate_ps <= 0:
        return None
    return float(np.log(max(ratio, 1.0))) / rate_ps


def _counted(history: History) -> BoolArray:
    """Whether each step (T,) counts: robots may move, and are not yet in the shape."""
    counted: BoolArray = history.shape_error >= history.mission.scenario.goal.shape_error
    counted[: len(counted) if history.ready_row is None else history.ready_row] = False
    return counted


def _change(values: np.ndarray) -> BoolArray:
    """Whether values (T, ...) of each step (T,) are not what they were a step before."""
    differs = (values[1:] != values[:-1]).any(axis=tuple(range(1, values.ndim)))
    return np.concatenate([[False], differs])


def _stretches(history: History) -> Iterator[_Stretch]:
    """The stretches between all changes of sets, roles and shape, as far as their steps count."""
    mission, times_s = history.mission, history.times_s
    counted, switched = _counted(history), _change(history.controlled)
    shapes = np.searchsorted(np.array([at_s - TIME_TOLERANCE_S for at_s, _ in mission.later]), times_s)
    other = _change(history.roles) | _change(shapes)
    has_kernel = history.conditions[:, 0] & history.conditions[:, 1]
    cuts = np.flatnonzero(switched | other | _change(counted))
    for begin, end in pairwise([0, *cuts.tolist(), times_s.size - 1]):
        if end == begin or not counted[begin]:
            continue
        shape = mission.shape_at(float(times_s[begin]), history.roles[begin])
        points, places = shape.points_of(history.ids).conj(), to_complex(history.positions_m[end])
        V_last = total_cost(points, places, history.controlled[begin])
        if min(history.V[begin], V_last, history.V[end]) <= 0:
            continue  # partial shapes to the last digit: nothing falls, and no ratio is finite
        switches = switched[end] and not other[end] and counted[end] and has_kernel[begin] and has_kernel[end]
        yield _Stretch(begin, end, V_last, bool(switches), bool(has_kernel[begin]))


def _rate_ps(history: History, stretch: _Stretch) -> float:
    """Rate, 1/s, at which V fell along a stretch."""
    lasted_s = float(history.times_s[stretch.last] - history.times_s[stretch.first])
    return float(np.log(history.V[stretch.first] / stretch.V_last)) / lasted_s


def _of_linear_model(history: History, stretches: list[_Stretch]) -> tuple[float | None, float | None]:
    """μ over all positions for the changes that were, and the least 2 k λ_3, 1/s; None where not known."""
    control = history.mission.scenario.control
    if control.method != "similarity" or control.gains != "marker" or history.ids.size > MAX_ROBOTS:
        return None, None
    ratios = []
    least = np.inf
    for stretch in stretches:
        if not stretch.has_kernel:
            continue
        before = _form(history, stretch.first)
        values, modes = np.linalg.eigh(before)
        if values[2] < MIN_RATE:
            return None, None
        least = min(least, float(values[2]))
        if stretch.switches:
            unit = modes[:, 2:] / np.sqrt(values[2:])  # V before is |c|²/2 for positions `unit @ c`
            after = unit.conj().T @ _form(history, stretch.last) @ unit
            ratios.append(float(np.linalg.eigvalsh(after)[-1]))
    return max(ratios, default=None), 2 * control.k * least if np.isfinite(least) else None


def _form(history: History, row: int) -> ComplexArray:
    """L (N, N) of a step's topology: V = 1/2 p* L p."""
    shape = history.mission.shape_at(float(history.times_s[row]), history.roles[row])
    return laplacian(shape.points_of(history.ids), [np.flatnonzero(mine) for mine in history.controlled[row]])
