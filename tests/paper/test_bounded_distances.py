"""Corollary 2: distances between robots stay bounded, by V at the start and a stop threshold.

The paper: V_0 is finite and V never increases, so every |x_i - x_i^{d,j}| is at most sqrt(2 V_0). Speeds are
bounded, and robots that stop below a threshold stop in finite time. Let g_i = Σ_j (x_i^{d,j} - x_i) be the
vector that robot i follows (eq. 5), k its gain, and b the threshold, m:

1. *Speed.* Robot i has at most two units (TC4). Therefore |g_i|² <= 2 Σ_j |x_i^{d,j} - x_i|² and Σ_i |g_i|²
  <= 4 V. No speed is above 2 k sqrt(V_0), and in a time t two robots separate by at most sqrt(8 V_0) k t.
2. *Path.* V falls by k cos δ_i |g_i|² per unit of time for each moving robot (eq. 14). δ_i is the angle
  between its path and g_i. Such a robot has |g_i| >= b, and drives at k |g_i| <= k |g_i|² / b. Where cos δ_i
  >= c, the paths of all robots together are thus at most (V_0 - V) / (b c) for all time. No two robots
  separate by more than V_0 / (b c).

The second bound is that of the corollary, as it contains no time. Robots that can move to any side have c =
1. For steps of a time h it is exact with c - k h for c. A move by D raises V by at most Σ_i |D_i|² above its
first order (`test_lyapunov.py`), and |D_i| <= k h |g_i|.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from skyherd.control import MarkerGains, laplacian
from skyherd.control.robots.unicycle import unicycle_law
from skyherd.geometry import to_complex, to_points
from skyherd.sim.world import move_unicycles

ROUNDING = 1e-9
"""Relative: sums of thousands of steps, each correct to 1e-16 of positions."""

K_OMEGA, STEP_S, STEPS = 4.0, 0.05, 400
"""1/s; s; Chosen: twenty times 1/k, in which most runs come to rest."""


@dataclass
class Team:
    """Robots, their units' sets, and the threshold, m, below which they stop."""

    L: np.ndarray
    positions: np.ndarray
    headings: np.ndarray
    threshold_m: float
    k: float = 1.0

    def V(self, p: np.ndarray) -> float:
        return float(np.vdot(p, self.L @ p).real) / 2


@dataclass
class Run:
    """Result of a team's run.

    Attributes:
        ways_m: (N,) length of each robot's path.
        parted_m: (T, pairs) increase of the distances of pairs of robots since the start.
        V: (T,).
        cosine: minimum cosine between a robot's path in a step and the vector that it follows.
        rests: whether all robots have stopped.
    """

    ways_m: np.ndarray
    parted_m: np.ndarray
    V: np.ndarray
    cosine: float
    rests: bool


def drive(team: Team, *, sideways: bool, steps: int = STEPS, sense: float = 1.0) -> Run:
    """Simulate the paper's law with its threshold: points that move to any side, or unicycles."""
    law = MarkerGains(team.k, K_OMEGA, team.threshold_m, 1.0)
    p, headings = team.positions.copy(), team.headings.copy()
    ways, parted, V, cosine = np.zeros(p.size), [], [team.V(p)], 1.0
    apart = pdist(to_points(p))
    for _ in range(steps):
        g = -sense * (team.L @ p)
        g = np.where(np.abs(g) >= law.b_th, g, 0)
        if not g.any():
            break
        if sideways:
            moved = p + team.k * STEP_S * g
        else:
            v, omega = unicycle_law(g * np.exp(-1j * headings), law)
            places, headings = move_unicycles(to_points(p), headings, v, omega, STEP_S)
            moved = to_complex(places)
        way, driven = moved - p, np.abs(team.k * STEP_S * g)
        going = driven > 0
        along = (way * g.conj()).real[going] / (driven * np.abs(g))[going]
        cosine, ways, p = min(cosine, float(along.min())), ways + driven, moved
        parted.append(pdist(to_points(p)) - apart)
        V.append(team.V(p))
    return Run(ways, np.array(parted or [0 * apart]), np.array(V), cosine, not g.any())


def tree_sets(rng: np.random.Generator, units: int) -> list[np.ndarray]:
    """Return random sets on a random tree: each edge shares two robots that no other unit has (TC1-TC5)."""
    sets, free, robots = [list(range(4))], [set(range(4))], 4
    for _ in range(1, units):
        parent = int(rng.choice([unit for unit in range(len(sets)) if len(free[unit]) >= 2]))
        pair = rng.permutation(sorted(free[parent]))[:2].tolist()
        free[parent] -= set(pair)
        fresh = list(range(robots, robots + int(rng.integers(2, 5))))
        sets.append(pair + fresh)
        free.append(set(fresh))
        robots += len(fresh)
    return [np.array(members) for members in sets]


def team_of(seed: int, units: int, spread_m: float, share: float) -> Team:
    """Return a random start, whose threshold is a share of the longest initial vector of a robot."""
    rng = np.random.default_rng(seed)
    sets = tree_sets(rng, units)
    count = 1 + max(int(members.max()) for members in sets)
    cloud = rng.standard_normal((2, count)) + 1j * rng.standard_normal((2, count))
    L, positions = laplacian(cloud[0], sets), spread_m * cloud[1]
    longest_m = float(np.abs(L @ positions).max())
    return Team(L, positions, rng.uniform(-np.pi, np.pi, count), share * longest_m)


teams = st.builds(
    team_of,
    seed=st.integers(0, 2**32 - 1),
    units=st.integers(1, 5),
    spread_m=st.floats(0.01, 100.0),
    share=st.floats(0.02, 0.9),
)


@settings(max_examples=60)
@given(team=teams)
def test_paths_and_distances_satisfy_bound(team: Team) -> None:
    """Points that move to any side: all assumptions hold, c = 1."""
    run = drive(team, sideways=True)
    budget_m = (run.V[0] - run.V[-1]) / (team.threshold_m * (1 - team.k * STEP_S))
    assert run.ways_m.sum() <= budget_m * (1 + ROUNDING)
    assert run.parted_m.max() <= budget_m * (1 + ROUNDING)
    assert (np.diff(run.V) < 0).all()


@settings(max_examples=60)
@given(team=teams)
def test_unicycles_satisfy_bound_for_their_angle(team: Team) -> None:
    """Robots start within 60 degrees of their vectors, forwards or backwards, as the law turns them.

    c is the minimum cosine along the run: a robot whose vector rotates, as others move, may be farther off
    than at the start. Runs with a robot at right angles have no bound of the second kind, and are omitted.
    """
    g = -(team.L @ team.positions)
    team.headings = np.angle(g) + (team.headings / 3)
    run = drive(team, sideways=False)
    c = run.cosine - team.k * STEP_S
    assume(c > 0.05)
    budget_m = (run.V[0] - run.V[-1]) / (team.threshold_m * c)
    assert run.ways_m.sum() <= budget_m * (1 + ROUNDING)
    assert run.parted_m.max() <= budget_m * (1 + ROUNDING)


@settings(max_examples=60)
@given(team=teams)
def test_speeds_satisfy_bound_at_any_heading(team: Team) -> None:
    """sqrt(8 V_0) k t for unicycles at any heading; V may rise within a step by the step's error."""
    run = drive(team, sideways=False, steps=100)
    fastest = np.sqrt(run.V[:-1]) if len(run.V) > 1 else np.zeros(1)
    bound_m = np.sqrt(8) * team.k * STEP_S * np.cumsum(np.maximum.accumulate(fastest))
    assert (run.parted_m.max(axis=1) <= bound_m * (1 + ROUNDING) + ROUNDING).all()


def test_large_threshold_stops_robots_far_from_shape() -> None:
    """The assumption of a finite time: with the threshold all robots stop, and V stays above zero."""
    rests = [drive(team_of(seed, 3, 5.0, 0.3), sideways=False) for seed in range(20)]
    assert all(run.rests for run in rests)
    assert min(run.V[-1] / run.V[0] for run in rests) > 1e-4


def test_bound_is_tight_within_one_percent() -> None:
    """Vectors 1 % above the threshold: a robot's path is (g - b) / λ, and the bound (g² - b²) / (2 λ b).

    One unit, and errors that all have the same length: six robots off a hexagon by a mode of its own.
    """
    shape, error = (np.exp(turns * np.pi * 1j * np.arange(6) / 6) for turns in (2, 4))  # at right angles
    L = laplacian(shape, [np.arange(6)])
    np.testing.assert_allclose(L @ error, error, atol=1e-12)
    team = Team(L, shape + 1.01 * error, np.zeros(6), 1.0, k=0.002)
    run = drive(team, sideways=True, steps=2000)
    assert run.rests
    budget_m = (run.V[0] - run.V[-1]) / (team.threshold_m * (1 - team.k * STEP_S))
    assert 0.99 * budget_m < run.ways_m.sum() <= budget_m * (1 + ROUNDING)


@pytest.mark.parametrize("seed", range(5))
def test_bound_fails_without_its_assumptions(seed: int) -> None:
    """Goals on the wrong side, so that V rises; robots that stop too late; another topology.

    V of the former topology does not constrain later motion: there Proposition 1 must hold.
    """
    team = team_of(seed, 3, 5.0, 0.2)
    bound_m = team.V(team.positions) / (team.threshold_m * (1 - STEP_S))
    assert drive(team, sideways=True).ways_m.sum() < bound_m
    assert drive(team, sideways=True, sense=-1.0, steps=100).ways_m.sum() > bound_m
    formed = 5 * np.linalg.eigh(team.L)[1][:, 2]  # of this topology V is small: its weakest mode
    another = laplacian(np.random.default_rng(seed).permutation(formed), [np.arange(formed.size)])
    bound_m = team.V(formed) / (0.5 * (1 - STEP_S))
    for L, within in ((team.L, True), (another, False)):
        changed = Team(L, formed, team.headings, 0.5)
        assert (drive(changed, sideways=True).ways_m.sum() <= bound_m) == within


def test_late_stop_exceeds_bound() -> None:
    """Vectors of 1.5 m and a bound for robots that stop at 0.9 m, which these do or do not."""
    shape, error = (np.exp(turns * np.pi * 1j * np.arange(6) / 6) for turns in (2, 4))
    team = Team(laplacian(shape, [np.arange(6)]), shape + 1.5 * error, np.zeros(6), 0.02)
    for threshold_m, within in ((0.9, True), (0.02, False)):
        team.threshold_m = threshold_m
        bound_m = team.V(team.positions) / (0.9 * (1 - STEP_S))
        assert (drive(team, sideways=True).ways_m.sum() <= bound_m) == within
