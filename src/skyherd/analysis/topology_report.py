"""Report on a topology: graph, violations of TC1-TC5 with reasons, and convergence rate."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from skyherd.analysis.history import History
from skyherd.analysis.topology_changes import robot_names
from skyherd.control import (
    Conditions,
    ControlSets,
    Template,
    check_conditions,
    control_matrix,
    graph_edges,
    laplacian,
    slowest_rate,
)
from skyherd.datasets import Mission
from skyherd.geometry import Array, ComplexArray, IntArray

Edge = tuple[int, int]
"""Two units that share robots, the lower one first."""

FLAT = 0.25
"""Ratio of the decrease of log error in the last third of the time to that in the middle third. Below it, an
error is at its floor. Chosen: 1 for a steady decrease, 0 at rest; larger values take a slow mode for a floor.
"""

FLOOR_FACTOR = 3.0
"""Multiple of the least error below which an error counts as at its floor. Chosen: noise about a floor stays
below."""

MIN_SAMPLES = 20
"""Minimum number of steps for a rate estimate. Chosen: with half as many the slope is mostly noise."""

MIN_RATE = 1e-9
"""Threshold below which eigenvalues of the Laplacian are zero. Derived: exceeds rounding, about 1e-15 times
the number of robots."""


NOT_REQUIRED = "sufficient, not required here"
"""Remark on TC3 to TC5 in scenarios whose topologies are in Q."""


def required_conditions(mission: Mission) -> int:
    """Return the number of conditions that a mission keeps: TC1 and TC2 in Q, or all five in P.

    Units that control all robots inside their safety radius overlap freely. TC1 and TC2 then suffice for
    local convergence.
    """
    return 2 if mission.scenario.selection.kind == "radius" else 5


@dataclass(frozen=True)
class Breach:
    """Violation of a condition: the condition's number, and a sentence with the reason."""

    condition: int
    what: str


@dataclass(frozen=True)
class TopologyReport:
    """A topology and its properties.

    Attributes:
        sets: S_j^c by unit.
        shared: robots shared by two units, for each edge of G_c.
        conditions: TC1-TC5.
        breaches: reasons of the violations.
        slowest: λ_3 of L, the slowest mode's rate in units of the gain k
            (control/topology/convergence_rate.py).
    """

    sets: ControlSets
    shared: dict[Edge, list[int]]
    conditions: Conditions
    breaches: list[Breach]
    slowest: float


def judge_topology(sets: ControlSets, template: Template) -> TopologyReport:
    """Make the report on the sets of all living units, by unit, over the robots of a template."""
    shared = {edge: _common(sets, *edge) for edge in graph_edges(sets)}
    rows = _rows(sets, template)
    return TopologyReport(
        sets=sets,
        shared=shared,
        conditions=check_conditions(control_matrix(sets, template.ids)),
        breaches=list(_breaches(sets, list(shared), template.ids)),
        slowest=slowest_rate(template.points_px, rows),
    )


def _rows(sets: ControlSets, template: Template) -> list[IntArray]:
    return [np.searchsorted(template.ids, ids) for ids in sets.values()]


def _common(sets: ControlSets, j: int, k: int) -> list[int]:
    common: list[int] = np.intersect1d(sets[j], sets[k]).tolist()
    return common


def _breaches(sets: ControlSets, links: list[Edge], ids: IntArray) -> Iterator[Breach]:
    """List the violations of each condition; a disconnected graph also violates TC5, reported once."""
    parts = _parts(sorted(sets), links)
    if len(parts) > 1:
        names = " | ".join(", ".join(str(unit) for unit in part) for part in parts)
        yield Breach(1, f"units are disconnected: {len(parts)} groups without two common robots: {names}")
    held = np.unique(np.concatenate([*sets.values(), np.zeros(0, dtype=np.int64)]))
    if (lost := np.setdiff1d(ids, held)).size:
        yield Breach(2, f"{robot_names(lost.tolist())}: controlled by no unit")
    for j, k in combinations(sorted(sets), 2):
        common = _common(sets, j, k)
        if len(common) not in (0, 2):
            yield Breach(3, f"units {j} and {k} share {len(common)}, not two or none: {robot_names(common)}")
    for robot in ids.tolist():
        owners = [unit for unit in sorted(sets) if robot in sets[unit]]
        if len(owners) > 2:
            names = ", ".join(str(unit) for unit in owners)
            yield Breach(4, f"robot {robot}: controlled by {len(owners)} units: {names}")
    if cycle := _on_cycles(links):
        yield Breach(5, f"units on a cycle: {', '.join(str(unit) for unit in cycle)}")
    elif len(parts) > 1:
        yield Breach(5, "no tree, since the units are disconnected (TC1)")


def _parts(units: list[int], links: list[Edge]) -> list[list[int]]:
    """Return the connected components of the graph."""
    label = {unit: unit for unit in units}
    for j, k in links:
        old, new = label[k], label[j]
        label = {unit: new if part == old else part for unit, part in label.items()}
    return [[unit for unit in units if label[unit] == part] for part in dict.fromkeys(label.values())]


def _on_cycles(links: list[Edge]) -> list[int]:
    """Return the units left after repeated removal of leaves: none in a forest."""
    while links:
        ends = [unit for link in links for unit in link]
        kept = [link for link in links if min(ends.count(unit) for unit in link) > 1]
        if len(kept) == len(links):
            break
        links = kept
    return sorted({unit for link in links for unit in link})


def predicted_time_s(
    sets: ControlSets, template: Template, positions: ComplexArray, gain_ps: float, error: float
) -> float | None:
    """Return the time, s, to reach the shape error `error` under `dp/dt = -k L p`; None if never.

    In L's modes `p = Σ_i c_i v_i` each `c_i` decays as `exp(-k λ_i t)`. Those of `λ = 0`, the similarities of
    the template, stay: `error(t)² = Σ_{i ≥ 3} |c_i|² exp(-2 k λ_i t) / |p - mean|²`. Positions (N,) are in
    map sense. The model has no speed limits and assumes holonomic robots.
    """
    values, modes = np.linalg.eigh(laplacian(template.points_px, _rows(sets, template)))
    if positions.size < 3 or values[2] < MIN_RATE:
        return None
    image_sense = (positions - positions.mean()).conj()
    parts = np.abs(modes.conj().T @ image_sense) ** 2
    rigid = parts[:2].sum()

    def excess(time_s: float) -> float:
        residual = parts[2:] @ np.exp(-2 * gain_ps * values[2:] * time_s)
        return float(np.log(residual / (residual + rigid)) / 2 - np.log(error))

    if excess(0.0) <= 0:
        return 0.0
    longest_s = float(20 / (gain_ps * values[2]))
    while excess(longest_s) > 0:
        longest_s *= 2
    from scipy.optimize import brentq  # Imported here: it takes 0.2 s.

    return float(brentq(excess, 0.0, longest_s))


def resting_error(slowest: float, threshold: float) -> float:
    """Return a bound on the RMS distance from the shape of robots that stop below a threshold.

    At rest `|(L p)_i| < b` for each of N robots, so that `|L p| < b sqrt(N)`. L shrinks the part of p that is
    no similarity of the template by λ_3 at most. That part is less than `b sqrt(N) / λ_3`: RMS `b / λ_3`, in
    the unit of the threshold.
    """
    return threshold / slowest if slowest > 0 else np.inf


def measured_rate_ps(times_s: Array, errors: Array) -> float | None:
    """Return the final decay rate, 1/s, of a shape error (T,); None with too few steps.

    The rate is minus the least-squares slope of log error over the second half of the stretch above the
    floor. The floor is three times the least error, if the error stops decreasing at all.
    """
    if errors.size >= MIN_SAMPLES and _is_flat(np.log(errors)):
        above = np.flatnonzero(errors > FLOOR_FACTOR * errors.min())
        times_s, errors = (values[: above[-1] + 1 if above.size else 0] for values in (times_s, errors))
    late = slice(errors.size // 2, None)
    if errors[late].size < MIN_SAMPLES:
        return None
    return float(-np.polyfit(times_s[late], np.log(errors[late]), 1)[0])


def _is_flat(logs: Array) -> bool:
    """Return whether values (T,) stop decreasing in their last third."""
    third = logs.size // 3
    return bool(logs[-third] - logs[-1] < FLAT * (logs[third] - logs[-third]))


def last_stretch(history: History) -> slice:
    """Return the steps since the last topology change and since the tree of units was complete."""
    changes = np.flatnonzero((history.controlled[1:] != history.controlled[:-1]).any(axis=(1, 2))) + 1
    ready = history.ready_row
    first = max(int(changes[-1]) if changes.size else 0, 0 if ready is None else ready)
    return slice(first, None)
