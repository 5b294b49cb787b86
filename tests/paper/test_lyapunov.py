"""Section V of the paper: the gradient of V^j (Lemma 2), and that V never increases (Theorem 1).

x^{d,j} = P_j x, where P_j projects onto the similarities of the template (Algorithm 1 is linear in the
current points). The Lyapunov function `V = 1/2 Σ_j |(I - P_j) x_j|²` is therefore a quadratic form. A robot
under c units contributes at most c to its Hessian. For a move by D, with c = 2 under TC4,

    V(x + D) <= V(x) + Σ_i grad_i·D_i + Σ_i |D_i|².

In a step of dt at constant v and omega a robot moves by a chord no longer than k |rho_i| dt. The chord is
less than 90 degrees off rho_i = -grad_i: the law turns it towards the goal, by less than the error while
k_omega dt < 1. The step itself thus raises V by at most (k dt)² Σ_i |rho_i|². Over the time dt that is a rate
that vanishes with dt: the continuous-time claim. The tests check that bound.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from skyherd.control import MarkerGains, Template, desired_points
from skyherd.control.robots.unicycle import unicycle_law
from skyherd.control.topology.conditions import check_conditions
from skyherd.geometry import to_complex, to_points
from skyherd.sim.truth_metrics import TruthObserver
from skyherd.sim.world import move_unicycles

ROUNDING = 1e-12
"""Relative to V: sums of tens of squares in double precision leave 1e-15 of V's start."""


@dataclass
class Team:
    """Start of N robots under U units: control sets, a template in map sense, and individual gains."""

    sets: list[np.ndarray]
    template: np.ndarray
    positions: np.ndarray
    headings: np.ndarray
    gain: np.ndarray
    k_omega: float

    def matrix(self) -> np.ndarray:
        return np.array([np.isin(np.arange(self.template.size), members) for members in self.sets])

    def goals(self, positions: np.ndarray) -> tuple[np.ndarray, float]:
        """Return Σ_j (x^{d,j} - x) by robot, and V, from skyherd's own Algorithm 1."""
        total, squares = np.zeros(positions.size, dtype=complex), 0.0
        for members in self.sets:
            rho = desired_points(self.template[members], positions[members]) - positions[members]
            total[members] += rho
            squares += float(np.sum(np.abs(rho) ** 2))
        return total, squares / 2


def tree_sets(rng: np.random.Generator, units: int) -> list[np.ndarray]:
    """Return random sets on a random tree: each edge shares two robots that no other unit has (TC1-TC5)."""
    sets = [
        list(range(rng.integers(3, 7) if units > 1 else rng.integers(3, 8)))
    ]  # two robots alone are always in shape
    taken: set[int] = set()
    robots = len(sets[0])
    for _ in range(1, units):
        parents = [j for j, members in enumerate(sets) if len(set(members) - taken) >= 2]
        parent = sets[rng.choice(parents)]
        pair = rng.permutation(sorted(set(parent) - taken))[:2].tolist()
        taken |= set(pair)
        fresh = int(rng.integers(2, 6))
        sets.append(pair + list(range(robots, robots + fresh)))
        robots += fresh
    return [np.sort(members) for members in sets]


def random_team(rng: np.random.Generator, sets: list[np.ndarray]) -> Team:
    count = int(max(members.max() for members in sets)) + 1

    def cloud() -> np.ndarray:
        return rng.standard_normal(count) + 1j * rng.standard_normal(count)

    return Team(
        sets=sets,
        template=cloud() * rng.uniform(0.1, 100),
        positions=5 * cloud(),
        headings=rng.uniform(-np.pi, np.pi, count),
        gain=rng.uniform(0.2, 1.0, count),  # stands for k_v rbar_i, unknown and different for each robot
        k_omega=float(rng.uniform(0.3, 4.0)),
    )


def step(
    team: Team, rho: np.ndarray, positions: np.ndarray, headings: np.ndarray, dt: float
) -> tuple[np.ndarray, ...]:
    """Drive one exact arc towards goals at `rho`; return positions, headings and the bound on V's rise."""
    v, omega = unicycle_law(rho * np.exp(-1j * headings), MarkerGains(1.0, team.k_omega, 0.0, 1.0))
    moved, turned = move_unicycles(to_points(positions), headings, team.gain * v, omega, dt)
    bound = float(np.sum((team.gain * np.abs(rho) * dt) ** 2))
    return to_complex(moved), turned, bound


@pytest.mark.parametrize("units", [1, 2, 3, 4, 5])
@pytest.mark.parametrize(
    ("starts", "dt", "steps"), [(12, 0.03, 100), pytest.param(40, 0.02, 150, marks=pytest.mark.slow)]
)
def test_lyapunov_function_never_increases_under_tc1_to_tc5(
    units: int, starts: int, dt: float, steps: int
) -> None:
    """Random starts for each number of units, over three time constants 1/k.

    Both bounds include the step: V's rise in one is at most Σ|D_i|², of order dt².
    """
    rng = np.random.default_rng([2019, units])
    for _ in range(starts):
        team = random_team(rng, tree_sets(rng, units))
        assert check_conditions(team.matrix()).in_p
        positions, headings = team.positions, team.headings
        rho, start = team.goals(positions)
        previous, worst_rate = start, 0.0
        for _ in range(steps):
            positions, headings, bound = step(team, rho, positions, headings, dt)
            rho, cost = team.goals(positions)
            assert cost - previous <= bound + ROUNDING * start
            worst_rate = max(worst_rate, (cost - previous) / dt)
            previous = cost
        assert previous < start, "and it decreases"
        # Σ|rho|² <= 4 V for such a form, and gains are at most 1: a rate of at most 4 dt of V's start.
        assert worst_rate <= 4 * dt * start


def test_lyapunov_increase_rate_vanishes_with_step() -> None:
    """Starts constructed to rise: every robot at right angles to its goal, where dV/dt is 0."""
    rng = np.random.default_rng(9)
    rises = 0
    for _ in range(20):
        team = random_team(rng, tree_sets(rng, 3))
        team.k_omega = 0.3  # turning slowly towards its goal
        rho, cost = team.goals(team.positions)
        across = np.angle(rho) + np.pi / 2 - 1e-9
        rates = []
        for dt in (0.04, 0.02, 0.01, 0.005):
            positions, _, _ = step(team, rho, team.positions, across, dt)
            rates.append((team.goals(positions)[1] - cost) / dt)
        # rate = -c1 dt (turning towards the goal) + c2 dt (the form's curvature) + O(dt²): halves with dt.
        ratio = np.array(rates[1:]) / np.array(rates[:-1])
        np.testing.assert_allclose(ratio, 0.5, atol=0.1)
        rises += rates[0] > 0
    assert rises > 5, "sensitivity: a finite step raises V here"


def test_lyapunov_rate_equals_equation_of_paper() -> None:
    """dV/dt = -Σ_i gain_i cos(alpha_i - alpha_d) |Σ_j (x^{d,j} - x_i)|² <= 0, by central differences.

    V is smooth along an arc; with h = 1e-4 the error is h² V'''/6, under 1e-7 of V.
    """
    rng = np.random.default_rng(10)
    h = 1e-4
    for _ in range(50):
        team = random_team(rng, tree_sets(rng, int(rng.integers(1, 6))))
        rho, cost = team.goals(team.positions)
        bearing = np.angle(rho) - team.headings
        predicted = -np.sum(team.gain * np.abs(np.cos(bearing)) * np.abs(rho) ** 2)
        v, omega = unicycle_law(rho * np.exp(-1j * team.headings), MarkerGains(1.0, team.k_omega, 0.0, 1.0))
        ahead, behind = (
            team.goals(
                to_complex(
                    move_unicycles(to_points(team.positions), team.headings, team.gain * v, omega, t)[0]
                )
            )[1]
            for t in (h, -h)
        )
        assert predicted < 0
        assert (ahead - behind) / (2 * h) == pytest.approx(predicted, abs=1e-6 * cost)


def test_lyapunov_term_gradient_equals_lemma_2() -> None:
    """dV^j/dx_i = x_i - x_i^{d,j}, against central differences of the observer's V^j.

    V^j is quadratic, so that central differences have no truncation error; with h = 1e-3 rounding leaves
    1e-16 V / h = 1e-12 V.
    """
    rng = np.random.default_rng(11)
    h = 1e-3
    for _ in range(20):
        team = random_team(rng, tree_sets(rng, 3))
        count = team.template.size
        ids = np.arange(count)
        observer = TruthObserver(Template(ids, team.template.conj()), ids)
        sets = dict(enumerate(team.sets))

        def shares(
            positions: np.ndarray, observer: TruthObserver = observer, sets: dict = sets
        ) -> np.ndarray:
            return observer.observe(to_points(positions), sets).V_units

        cost = shares(team.positions).sum()
        assert cost == pytest.approx(team.goals(team.positions)[1], rel=1e-12), (
            "the observer's V is equation 9"
        )
        for robot in range(count):
            nudge = h * (ids == robot)
            d_x = (shares(team.positions + nudge) - shares(team.positions - nudge)) / (2 * h)
            d_y = (shares(team.positions + 1j * nudge) - shares(team.positions - 1j * nudge)) / (2 * h)
            for j, members in enumerate(team.sets):
                expected = 0j
                if robot in members:
                    desired = desired_points(team.template[members], team.positions[members])
                    expected = team.positions[robot] - desired[members == robot][0]
                assert d_x[j] + 1j * d_y[j] == pytest.approx(expected, abs=1e-9 * cost)


@pytest.mark.parametrize("starts", [8, pytest.param(20, marks=pytest.mark.slow)])
def test_lyapunov_function_decreases_without_tc3_to_tc5(starts: int) -> None:
    """Contrast, a cycle of three units that share three robots each, one robot held by all three (Q, not P).

    The same argument holds with c = 3 units on a robot, Hessian at most 3: a bound 1.5 times as large.
    """
    rng = np.random.default_rng(12)
    sets = [np.array([0, 1, 2, 3, 9]), np.array([2, 3, 4, 5, 9]), np.array([4, 5, 0, 1, 9])]
    for _ in range(starts):
        team = random_team(rng, [*sets, np.array([6, 7, 8, 0, 1])])
        conditions = check_conditions(team.matrix())
        assert conditions.in_q and not (conditions.tc3 or conditions.tc4 or conditions.tc5)
        positions, headings = team.positions, team.headings
        rho, start = team.goals(positions)
        previous = start
        for _ in range(150):
            positions, headings, bound = step(team, rho, positions, headings, 0.02)
            rho, cost = team.goals(positions)
            assert cost - previous <= 2.0 * bound + ROUNDING * start  # robots 0 and 1 have four units
            previous = cost
        assert previous < start


def test_formed_team_is_static() -> None:
    """Corollary 1: at V = 0 no robot drives; one without a goal does not turn either."""
    rng = np.random.default_rng(13)
    for _ in range(20):
        team = random_team(rng, tree_sets(rng, 3))
        formed = (2 - 3j) + 0.7 * np.exp(1.1j) * team.template
        rho, cost = team.goals(formed)
        size = np.abs(formed).max()
        assert cost < (1e-14 * size) ** 2 * 100
        v, _ = unicycle_law(rho * np.exp(-1j * team.headings), MarkerGains(1.0, team.k_omega, 0.0, 1.0))
        assert np.abs(v).max() < 1e-13 * size
