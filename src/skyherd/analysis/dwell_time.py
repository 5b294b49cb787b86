"""Dwell times of a run's topologies and the average dwell time τ_d of the paper's Proposition 1.

Proposition 1 states that a finite τ_d exists. It requires V_p <= μ V_q for any two topologies p and q at the
same positions (eq. 15), and that the Lyapunov function V_p decreases while p is active. If V_p decreases at a
rate of at least λ_0, then N switches within a time T give

    V(T) <= μ^N exp(-λ_0 T) V(0),    which vanishes if T / N > τ_d = ln μ / λ_0

(Hespanha and Morse 1999, with λ_0 for their 2 λ_0). A τ_d is sufficient but not necessary: V as one sum is
not the only Lyapunov function, and `docs/topology.md` has one that decreases at every switch.

Two pairs of μ and λ_0 are computed. Neither is a proof for the run's robots:

- *As measured*: μ is the greatest ratio of V after to V before a switch; λ_0 is the least rate between two
  switches. The μ of eq. 15 covers all positions, so that this one is an estimate from below. The λ_0 includes
  turning robots, speed limits, delays and noise.
- *Of the linear model* `dp/dt = -k L p`: μ is the greatest eigenvalue of L_q against L_p over all positions,
  a bound for the switches of the run. V decreases at 2 k λ_3(L_p) at least. The bound holds for robots that
  drive straight to their goals at one gain; robots at their speed limit are slower.

Steps count from the time when robots may move, and only while the shape error exceeds its goal. Within the
goal, noise and the stop threshold dominate V. Topologies without TC1 or TC2 have no μ, since V is 0 for wrong
shapes too. Switches from and to them count as switches but not in μ. New roles and new shapes end a stretch
of V without being topology switches.
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
"""Threshold below which a third eigenvalue of L is zero, so that the shape is free. Derived: exceeds
rounding, 1e-15 per robot."""

DIGITS = 12
"""Significant digits of reported values. Chosen: sums differ in the sixteenth digit with the memory layout,
and a recording must give the same summary when read again."""

MAX_ROBOTS = 200
"""Maximum number of robots for which the bound is computed. Chosen: the eigenvalues of a switch then take
10 ms, and their time grows with the third power."""


@dataclass(frozen=True)
class DwellTime:
    """Dwell times of a run and the requirement of Proposition 1; the module explains the method.

    All values are None for a run in which V never decreased, or in which no robot was allowed to move.

    Attributes:
        min_s: least time between two topology switches; None with fewer than two.
        mean_s: counted time over the number of switches in it; None without any.
        switch_ratio: μ as measured: V after over V before at the switch that raised it most. Below 1 if V
            decreased at all of them; None without a switch between topologies that satisfy TC1 and TC2.
        decay_ps: λ_0 as measured, 1/s; negative if V rose between two switches.
        needed_s: τ_d from both, an estimate. 0 if V rose at no switch: any dwell time then suffices. None
            without a switch, where Theorem 1 applies, or if V did not decrease somewhere.
        bound_s: τ_d of the linear model, for any positions. None without a switch, for gains in pixels, for
            laws other than the paper's, whose rate is unknown, and for more than `MAX_ROBOTS`.
    """

    min_s: float | None = None
    mean_s: float | None = None
    switch_ratio: float | None = None
    decay_ps: float | None = None
    needed_s: float | None = None
    bound_s: float | None = None


@dataclass(frozen=True)
class _Stretch:
    """Steps `first` to `last` with constant sets, roles and shape; the last step may start others.

    Attributes:
        V_last: V at the last step by the sets, roles and shape of the first.
        switches: True if it ends with a switch of the sets alone, and μ exists for it.
        has_kernel: True if TC1 and TC2 hold, so that V vanishes in the shape only.
    """

    first: int
    last: int
    V_last: float
    switches: bool
    has_kernel: bool


def estimate_dwell_time(history: History) -> DwellTime:
    """Compute the dwell times of a run and the requirement of Proposition 1."""
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
    """Round a value to `DIGITS` significant digits."""
    return None if value is None else float(f"{value:.{DIGITS}g}")


def _dwell_s(ratio: float | None, rate_ps: float | None) -> float | None:
    """Return ln μ / λ_0, 0 for μ below 1; None if either is unknown or V does not decrease."""
    if ratio is None or rate_ps is None or rate_ps <= 0:
        return None
    return float(np.log(max(ratio, 1.0))) / rate_ps


def _counted(history: History) -> BoolArray:
    """Return whether each step (T,) counts: robots may move, and are not yet in the shape."""
    counted: BoolArray = history.shape_error >= history.mission.scenario.goal.shape_error
    counted[: len(counted) if history.ready_row is None else history.ready_row] = False
    return counted


def _change(values: np.ndarray) -> BoolArray:
    """Return whether values (T, ...) of each step (T,) differ from those of the previous step."""
    differs = (values[1:] != values[:-1]).any(axis=tuple(range(1, values.ndim)))
    return np.concatenate([[False], differs])


def _stretches(history: History) -> Iterator[_Stretch]:
    """Return the stretches between all changes of sets, roles and shape, within the counted steps."""
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
            continue  # V is constant within rounding, so that no ratio is finite.
        switches = switched[end] and not other[end] and counted[end] and has_kernel[begin] and has_kernel[end]
        yield _Stretch(begin, end, V_last, bool(switches), bool(has_kernel[begin]))


def _rate_ps(history: History, stretch: _Stretch) -> float:
    """Return the rate, 1/s, at which V decreased along a stretch."""
    lasted_s = float(history.times_s[stretch.last] - history.times_s[stretch.first])
    return float(np.log(history.V[stretch.first] / stretch.V_last)) / lasted_s


def _of_linear_model(history: History, stretches: list[_Stretch]) -> tuple[float | None, float | None]:
    """Return μ over all positions for the run's switches, and the least 2 k λ_3, 1/s, or None."""
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
    """Return L (N, N) of a step's topology: V = 1/2 p* L p."""
    shape = history.mission.shape_at(float(history.times_s[row]), history.roles[row])
    return laplacian(shape.points_of(history.ids), [np.flatnonzero(mine) for mine in history.controlled[row]])
