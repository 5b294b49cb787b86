"""Dwell times of a run and Proposition 1, against an independently computed linear flow."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh, expm

from skyherd.analysis import dwell_time
from skyherd.analysis.dwell_time import DwellTime, estimate_dwell_time
from skyherd.analysis.history import History, make_history
from skyherd.control import laplacian
from skyherd.datasets import Mission, load_mission
from skyherd.geometry import to_complex, to_points
from skyherd.loop import run_steps
from skyherd.sim.truth_metrics import TruthObserver

CHAIN = [[range(8), range(6, 12), range(10, 16)], [range(6), range(4, 10), range(8, 16)]]
"""Two topologies of TC1-TC5 over 16 robots, each a chain of three units."""

SLOT, STEP_S = 20, 0.1
"""Steps between switches, and the time of a step, s."""


@pytest.fixture(scope="module")
def base() -> History:
    mission = load_mission("star", ["perception=ideal", "duration_s=0.1", "control.k=0.15"])
    return make_history(mission, run_steps(mission))


def form(mission: Mission, sets: list[range]) -> np.ndarray:
    """Return L in ground sense."""
    return laplacian(mission.template.points_of(mission.ids).conj(), [np.array(members) for members in sets])


def flown(base: History, slots: int, positions: np.ndarray | None = None) -> History:
    """Return a history of the exact linear flow with the two topologies in turn, a slot each."""
    mission = base.mission
    flows = [expm(-mission.scenario.control.k * STEP_S * form(mission, sets)) for sets in CHAIN]
    p = to_complex(mission.positions_m) if positions is None else positions
    observer = TruthObserver(mission.template, mission.ids)
    places, costs, errors, sets_of, held = [], [], [], [], []
    for row in range(slots * SLOT + 1):
        sets = CHAIN[min(row, slots * SLOT - 1) // SLOT % 2]
        members = {unit: mission.ids[np.array(rows)] for unit, rows in enumerate(sets)}
        told = observer.observe(to_points(p), members)
        places.append(to_points(p))
        costs.append(told.V)
        errors.append(told.shape.error)
        held.append([told.conditions.tc1, told.conditions.tc2, *[told.conditions.in_p] * 3])
        sets_of.append([np.isin(np.arange(p.size), rows) for rows in sets])
        p = flows[CHAIN.index(sets)] @ p
    rows = len(places)
    return replace(
        base,
        times_s=STEP_S * np.arange(rows),
        positions_m=np.array(places),
        V=np.array(costs),
        shape_error=np.array(errors),
        conditions=np.array(held),
        controlled=np.array(sets_of),
        roles=np.repeat(base.roles[:1], rows, axis=0),
        trees=[None] * rows,
    )


def before_a_change(base: History, errors: np.ndarray) -> np.ndarray:
    """Return positions that the first topology maps to the shape plus these errors within a slot."""
    shape = base.mission.template.points_of(base.mission.ids).conj()
    flow = expm(base.mission.scenario.control.k * SLOT * STEP_S * form(base.mission, CHAIN[0]))
    return shape + flow @ (errors / np.abs(errors).max())


def eigenvectors(base: History) -> np.ndarray:
    """Return errors (N, N - 2), ascending by the rise of V at the switch to the second topology."""
    first, second = (form(base.mission, sets) for sets in CHAIN)
    free = np.linalg.eigh(first)[1][:, 2:]
    return free @ eigh(free.conj().T @ second @ free, free.conj().T @ first @ free)[1]


def test_ratio_and_rate_match_quadratic_forms(base: History) -> None:
    """μ and λ_0 from p* L p and the exact flow, to the rounding of sums of a hundred squares."""
    history = flown(base, 6)
    assert history.conditions.all()
    told = estimate_dwell_time(history)
    L, p = [form(base.mission, sets) for sets in CHAIN], to_complex(history.positions_m)
    V = [[np.vdot(p[row], form_ @ p[row]).real / 2 for form_ in L] for row in range(0, 6 * SLOT + 1, SLOT)]
    jumps = [V[slot][slot % 2] / V[slot][1 - slot % 2] for slot in range(1, 6)]
    falls = [np.log(V[slot][slot % 2] / V[slot + 1][slot % 2]) / (SLOT * STEP_S) for slot in range(6)]
    assert max(jumps) > 1.1, "V rises at a change"
    assert told.switch_ratio == pytest.approx(max(jumps), rel=1e-9)
    assert told.decay_ps == pytest.approx(min(falls), rel=1e-9)
    assert told.needed_s == pytest.approx(np.log(max(jumps)) / min(falls), rel=1e-8)
    assert told.min_s == pytest.approx(SLOT * STEP_S)
    assert told.mean_s == pytest.approx(6 * SLOT * STEP_S / 5)


def test_average_dwell_time_inequality_holds_along_run(base: History) -> None:
    """V(T) <= μ^N exp(-λ_0 T) V(0) at all changes, and not without μ."""
    worst = before_a_change(base, eigenvectors(base)[:, -1])
    for start in (None, worst):
        history = flown(base, 8, start)
        told = estimate_dwell_time(history)
        assert told.switch_ratio is not None and told.decay_ps is not None
        at = slice(None, None, SLOT)
        changes = np.minimum(np.arange(history.times_s.size) // SLOT, 7)[at]
        falling = history.V[0] * np.exp(-told.decay_ps * history.times_s[at])
        assert (history.V[at] <= falling * told.switch_ratio**changes * (1 + 1e-9)).all()
    assert history.V[SLOT] > 1.5 * falling[1], "V rises at the first change, from the worst start"


def test_linear_model_bound_is_tight(base: History) -> None:
    """μ over all positions is the greatest generalised eigenvalue, attained by its eigenvector."""
    first, second = (form(base.mission, sets) for sets in CHAIN)
    free = np.linalg.eigh(first)[1][:, 2:]  # all but the similarities
    values = eigh(free.conj().T @ second @ free, free.conj().T @ first @ free, eigvals_only=True)
    rates = [np.linalg.eigvalsh(matrix)[2] for matrix in (first, second)]
    both = [flown(base, 2), flown(base, 2, before_a_change(base, eigenvectors(base)[:, -1]))]
    usual, worst = (estimate_dwell_time(history) for history in both)
    expected = np.log(values[-1]) / (2 * 0.15 * min(rates))
    assert usual.bound_s == pytest.approx(expected, rel=1e-6)
    assert worst.switch_ratio == pytest.approx(values[-1], rel=1e-6)
    assert usual.switch_ratio is not None and usual.switch_ratio < values[-1]
    assert usual.needed_s is not None and usual.needed_s < expected
    assert usual.decay_ps is not None and usual.decay_ps >= 2 * 0.15 * min(rates)


def test_run_without_switch_needs_no_dwell_time(base: History) -> None:
    told = estimate_dwell_time(flown(base, 1))
    assert told.decay_ps is not None and told.decay_ps > 0
    assert told == DwellTime(decay_ps=told.decay_ps)


def test_needed_time_is_zero_if_v_never_rises(base: History) -> None:
    """The second topology's V is the least share of the first's, so that V falls at the switch."""
    told = estimate_dwell_time(flown(base, 2, before_a_change(base, eigenvectors(base)[:, 0])))
    assert told.switch_ratio is not None and told.switch_ratio < 1
    assert told.needed_s == 0


def test_needed_time_is_none_if_v_does_not_fall(base: History) -> None:
    history = flown(base, 4)
    backwards = replace(
        history,
        positions_m=history.positions_m[::-1],
        V=history.V[::-1],
        controlled=history.controlled[::-1],
    )
    # V is least at the first step: all later values exceed its floor.
    told = estimate_dwell_time(backwards)
    assert told.decay_ps is not None and told.decay_ps < 0
    assert told.needed_s is None


def test_steps_in_shape_are_not_counted(base: History) -> None:
    """From 5 steps before the last slot, robots are back at their start, marked as in the shape."""
    whole, end = flown(base, 4), 3 * SLOT
    positions_m, V, errors = whole.positions_m.copy(), whole.V.copy(), np.ones_like(whole.V)
    positions_m[end - 5 :], V[end - 5 : end], V[end:] = positions_m[0], V[0], 100 * V[0]
    away = replace(whole, positions_m=positions_m, V=V, shape_error=errors)
    assert estimate_dwell_time(away).needed_s is None
    errors[end - 5 :] = 0.5 * base.mission.scenario.goal.shape_error
    errors[end - 6] = 1.0
    positions_m[end - 5] = whole.positions_m[end - 5]
    told, before = estimate_dwell_time(away), estimate_dwell_time(flown(base, 3))
    assert told.decay_ps is not None and told.decay_ps > 0
    assert (told.min_s, told.switch_ratio) == (before.min_s, before.switch_ratio)
    assert told.mean_s == pytest.approx((end - 5) * STEP_S / 2)


def test_switch_in_shape_gives_no_dwell_time(base: History) -> None:
    """The first of three switches is in the shape and soon followed by the second."""
    whole = flown(base, 4)
    controlled = whole.controlled.copy()
    controlled[SLOT - 1] = controlled[SLOT - 2, ::-1]  # three changes at once, while in the shape
    errors = np.where(np.arange(whole.V.size) < SLOT, 0.0, 1.0)
    told = estimate_dwell_time(replace(whole, controlled=controlled, shape_error=errors))
    assert told.min_s == pytest.approx(SLOT * STEP_S)
    errors = np.where(np.arange(whole.V.size) < SLOT, 1.0, 0.0)  # the shape is reached as sets change
    assert estimate_dwell_time(replace(whole, shape_error=errors)).switch_ratio is None


def test_switch_without_tc1_tc2_has_no_ratio_and_rate(
    base: History,
) -> None:
    """The second slot has lost a unit: its V covers other distances and is not comparable."""
    history, gone = flown(base, 4), slice(SLOT, 2 * SLOT)
    broken, V, controlled = history.conditions.copy(), history.V.copy(), history.controlled.copy()
    broken[gone, 1], controlled[gone, 2], V[gone] = False, False, 1e-3 * V[gone]
    lost = replace(history, conditions=broken, V=V, controlled=controlled)
    told, whole = estimate_dwell_time(lost), estimate_dwell_time(history)
    assert (told.mean_s, told.min_s) == (whole.mean_s, whole.min_s)
    assert told.decay_ps is not None and told.decay_ps > 0
    assert told.switch_ratio == pytest.approx(V[3 * SLOT] / before_change(history, 3 * SLOT))
    assert told.bound_s is not None and whole.bound_s is not None and told.bound_s <= whole.bound_s
    only = estimate_dwell_time(replace(flown(base, 2), conditions=broken[: 2 * SLOT + 1]))
    assert only.mean_s is not None and only.switch_ratio is None and only.needed_s is None


def before_change(history: History, row: int) -> float:
    """Return V at a step by the sets of the previous step."""
    p, sets = to_complex(history.positions_m[row]), CHAIN[(row - 1) // SLOT % 2]
    return float(np.vdot(p, form(history.mission, sets) @ p).real) / 2


def test_new_roles_end_stretch_without_switch(base: History) -> None:
    """V jumps at role exchanges within a slot and at a switch; neither enters rate or ratio."""
    plain, observer = flown(base, 3), TruthObserver(base.mission.template, base.mission.ids)
    for at in (SLOT - 5, 2 * SLOT):
        roles, V, positions_m = plain.roles.copy(), plain.V.copy(), plain.positions_m.copy()
        roles[at:], positions_m[at:] = roles[at:, ::-1], positions_m[at]  # from then on all stand still
        for row in range(at, V.size):
            sets = {unit: base.ids[mine] for unit, mine in enumerate(plain.controlled[row])}
            shape = base.mission.shape_at(0.0, roles[row])
            V[row] = observer.observe(positions_m[row], sets, shape=shape).V
        assert V[at] > 2 * plain.V[at]
        told = estimate_dwell_time(replace(plain, roles=roles, V=V, positions_m=positions_m))
        assert told.decay_ps == pytest.approx(0, abs=1e-9), "and not below"
        assert told.mean_s == estimate_dwell_time(plain).mean_s
        if at == 2 * SLOT:
            assert told.switch_ratio == pytest.approx(plain.V[SLOT] / before_change(plain, SLOT))


@pytest.mark.parametrize("setting", ["gains='pixel'", "method='affine-leaderless'"])
def test_bound_is_none_for_other_laws(base: History, setting: str) -> None:
    key, value = setting.split("=")
    scenario = base.mission.scenario
    control = scenario.control.model_copy(update={key: value.strip("'")})
    other = replace(
        base, mission=replace(base.mission, scenario=scenario.model_copy(update={"control": control}))
    )
    history = flown(other, 2)
    assert estimate_dwell_time(history).bound_s is None
    assert estimate_dwell_time(history).needed_s is not None


def test_bound_is_none_above_robot_limit(base: History, monkeypatch: pytest.MonkeyPatch) -> None:
    history = flown(base, 2)
    assert estimate_dwell_time(history).bound_s is not None
    monkeypatch.setattr(dwell_time, "MAX_ROBOTS", 15)
    assert estimate_dwell_time(history).bound_s is None
    assert estimate_dwell_time(history).needed_s is not None


def test_dwell_times_are_none_if_never_ready(base: History) -> None:
    selection = base.mission.scenario.selection.model_copy(update={"kind": "tree"})
    scenario = base.mission.scenario.model_copy(update={"selection": selection})
    history = replace(flown(base, 2), mission=replace(base.mission, scenario=scenario))
    assert estimate_dwell_time(history) == DwellTime()


def test_new_shape_ends_stretch_without_switch(base: History) -> None:
    """V jumps half-way through a slot, and robots stand still after it; the rate is that before."""
    at, template = SLOT // 2, base.mission.template
    other = replace(template, points_px=template.points_px.real + 0.1j * template.points_px.imag)
    mission = replace(base.mission, later=((at * STEP_S, other),))
    plain, observer = flown(base, 1), TruthObserver(template, base.ids)
    V, positions_m = plain.V.copy(), plain.positions_m.copy()
    positions_m[at:] = positions_m[at]
    for row in range(at, V.size):
        sets = {unit: base.ids[mine] for unit, mine in enumerate(plain.controlled[row])}
        V[row] = observer.observe(
            positions_m[row], sets, shape=mission.shape_at(row * STEP_S, plain.roles[row])
        ).V
    told = estimate_dwell_time(replace(plain, mission=mission, V=V, positions_m=positions_m))
    assert abs(np.log(V[at] / V[at - 1])) > 0.1, "V jumps"
    assert told == DwellTime(decay_ps=pytest.approx(0.0, abs=1e-9))
