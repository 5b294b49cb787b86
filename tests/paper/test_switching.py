"""Changes of topology (Proposition 1): a function that decreases under any switching, and its assumptions.

With L_σ of topology σ (`skyherd.control.topology.convergence_rate`) V_σ = 1/2 p* L_σ p is a different
Lyapunov function for each topology, and may increase at a switch. Half the squared distance to the shape, `E
= 1/2 |p - Π p|²`, is common to all. Π p is the best similar copy of the template among all robots (the
paper's 1/2 |X|²). As L_σ and Π are Hermitian and L_σ Π = 0, robots that drive straight to their goals, `dp/dt
= -k L_σ p`, have

    dE/dt = -k p* L_σ p = -2 k V_σ <= -2 k λ_3(L_σ) E

for any σ. E therefore decreases under any switching, however fast, if λ_3 > 0, which TC1 and TC2 ensure. For
robots with constant individual gains k_i it holds for the distance weighted by 1 / k_i.
"""

import numpy as np
import pytest

from skyherd.control import MarkerGains, check_conditions, laplacian, slowest_rate
from skyherd.control.robots.unicycle import Wheels, wheel_law
from skyherd.geometry import to_complex, to_points
from skyherd.sim.world import move_unicycles

ROBOTS, SLOT_S = 16, 2.0
K, K_OMEGA = 0.15, 0.6
"""Gains of the built-in star, 1/s."""

ROUNDING = 1e-12
"""Relative: distances are differences of numbers ten times as large, each correct to 1e-16."""


def cloud(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.standard_normal(count) + 1j * rng.standard_normal(count)


def matrix_of(sets: list[np.ndarray]) -> np.ndarray:
    return np.array([np.isin(np.arange(ROBOTS), members) for members in sets])


def tree_topology(rng: np.random.Generator, robots: np.ndarray) -> list[np.ndarray]:
    """Return sets on a random tree of two to five units; each edge shares two robots of its own."""
    order, units = rng.permutation(robots), int(rng.integers(2, min(5, robots.size // 2 - 1) + 1))
    least = np.array([4, *[2] * (units - 1)])
    sizes = least + rng.multinomial(robots.size - least.sum(), [1 / units] * units)
    parts = np.split(order, np.cumsum(sizes)[:-1])
    sets, free = [parts[0].tolist()], [set(parts[0].tolist())]
    for part in parts[1:]:
        parent = int(rng.choice([unit for unit in range(len(sets)) if len(free[unit]) >= 2]))
        pair = rng.permutation(sorted(free[parent]))[:2].tolist()
        free[parent] -= set(pair)
        sets.append(pair + part.tolist())
        free.append(set(part.tolist()))
    return [np.sort(members) for members in sets]


def ring_topology(rng: np.random.Generator) -> list[np.ndarray]:
    """Return four units in a ring that share three robots each: TC1 and TC2, not TC3 and TC5."""
    order = rng.permutation(ROBOTS)
    return [np.sort(np.take(order, range(start, start + 7), mode="wrap")) for start in range(0, 16, 4)]


def flow(L: np.ndarray, lasts_s: float) -> np.ndarray:
    """Return exp(-k L t) of the Hermitian L."""
    values, modes = np.linalg.eigh(L)
    return np.asarray((modes * np.exp(-K * lasts_s * values)) @ modes.conj().T)


def distance(points: np.ndarray, p: np.ndarray, weights: np.ndarray | float = 1.0) -> float:
    """Return half the weighted sum of squared distances from p (N,) to the nearest similar copy of points."""
    root = np.sqrt(np.broadcast_to(weights, p.shape))
    basis = np.stack([root, root * points], axis=1)
    rest = root * p - basis @ np.linalg.lstsq(basis, root * p, rcond=None)[0]
    return float(np.vdot(rest, rest).real) / 2


def slots(rng: np.random.Generator, mean_s: float, total_s: float) -> list[float]:
    """Return dwell times, each at most twice the mean, until the total is reached."""
    drawn: list[float] = []
    while sum(drawn) < total_s:
        drawn.append(float(rng.uniform(0.0, 2 * mean_s)))
    return drawn


@pytest.mark.parametrize("mean_s", [SLOT_S, 0.1, 0.005])
@pytest.mark.parametrize("kind", ["tree", "ring"])
def test_shape_distance_decreases_under_any_switching(kind: str, mean_s: float) -> None:
    """The exact linear flow, a random topology in each dwell time: E falls by at least exp(-2 k λ_3 t).

    Meanwhile V, the sum over units, increases at a considerable share of the changes.
    """
    rng = np.random.default_rng([1, int(1000 * mean_s), kind == "ring"])
    rises = changes = 0
    for _ in range(6):
        points, p = cloud(rng, ROBOTS), 5 * cloud(rng, ROBOTS)
        dwells = slots(rng, mean_s, min(20.0, 60 * mean_s))
        value, start, V = distance(points, p), distance(points, p), np.inf
        for dwell_s in dwells:
            sets = tree_topology(rng, np.arange(ROBOTS)) if kind == "tree" else ring_topology(rng)
            conditions = check_conditions(matrix_of(sets))
            assert conditions.in_p if kind == "tree" else conditions.in_q and not conditions.in_p
            L = laplacian(points, sets)
            rises += float(np.vdot(p, L @ p).real) / 2 > V
            changes += np.isfinite(V)
            p = flow(L, dwell_s) @ p
            V, before = float(np.vdot(p, L @ p).real) / 2, value
            value = distance(points, p)
            assert value <= before * np.exp(-2 * K * slowest_rate(points, sets) * dwell_s) + ROUNDING * start
        assert value < start
    assert rises > 0.2 * changes, "V itself is not monotonic"


def unicycles(
    rng: np.random.Generator, dwell_s: float, total_s: float, limit_mps: float = np.inf
) -> tuple[float, list[float]]:
    """Drive robots under skyherd's wheel law, a new random tree per dwell time; return E at slot ends."""
    points, p = cloud(rng, ROBOTS), 5 * cloud(rng, ROBOTS)
    headings = rng.uniform(-np.pi, np.pi, ROBOTS)
    start, told, step_s = distance(points, p), [], 0.1
    law, wheels = MarkerGains(K, K_OMEGA, 0.0, 1.0), Wheels(limit_mps, np.inf)
    for step in range(round(total_s / step_s)):
        if step % round(dwell_s / step_s) == 0:
            L = laplacian(points, tree_topology(rng, np.arange(ROBOTS)))
        v, omega = wheel_law(-(L @ p) * np.exp(-1j * headings), law, wheels)
        moved, headings = move_unicycles(to_points(p), headings, v, omega, step_s)
        p = to_complex(moved)
        if (step + 1) % round(SLOT_S / step_s) == 0:
            told.append(distance(points, p))
    return start, told


@pytest.mark.parametrize("dwell_s", [SLOT_S, 0.1])
@pytest.mark.parametrize("limit_mps", [np.inf, 0.5])
def test_unicycles_converge_with_dwell_time_of_two_seconds(dwell_s: float, limit_mps: float) -> None:
    """Unicycles at random headings, without and with a speed limit: E falls from slot to slot.

    After a minute, 30 slots, the shape error is below 1 % of its start. No topology occurs twice. Sets that
    change at every step, twenty times as often, converge as well.
    """
    rng = np.random.default_rng([2, int(10 * dwell_s), int(np.isfinite(limit_mps))])
    for _ in range(3):
        start, told = unicycles(rng, dwell_s, 60.0, limit_mps)
        assert (np.diff([start, *told]) < 0).all()
        assert told[-1] < 1e-4 * start


@pytest.mark.parametrize("mean_s", [SLOT_S, 0.1])
def test_one_shared_robot_leaves_shape_undetermined(mean_s: float) -> None:
    """Two halves that share only robot 0, each switching within P: V vanishes, and E stays positive.

    One half may rotate and scale about robot 0. Both halves' similarities have four numbers. The one position
    that they share leaves one mode that no topology observes. The flow keeps it, so that E never falls below
    its share, which is exact.
    """
    rng = np.random.default_rng([3, int(10 * mean_s)])
    for _ in range(2):
        points, p = cloud(rng, ROBOTS), 5 * cloud(rng, ROBOTS)
        free = np.where(np.arange(ROBOTS) < 8, points - points[0], 0)
        basis = np.linalg.qr(np.stack([np.ones(ROBOTS), points, free], axis=1))[0]
        kept = abs(np.vdot(basis[:, 2], p)) ** 2 / 2
        for dwell_s in slots(rng, mean_s, 900.0 if mean_s > 1 else 20.0):
            halves = np.arange(8), np.r_[0, np.arange(8, ROBOTS)]
            sets = [members for half in halves for members in tree_topology(rng, half)]
            conditions = check_conditions(matrix_of(sets))
            assert conditions.tc2 and not conditions.tc1
            L = laplacian(points, sets)
            p = flow(L, dwell_s) @ p
            assert distance(points, p) >= kept * (1 - ROUNDING)
        if mean_s > 1:
            assert np.vdot(p, L @ p).real < 1e-9, "each half is in shape"
            assert distance(points, p) == pytest.approx(kept, rel=1e-6)


def quickest_rise(points: np.ndarray, L: np.ndarray, factors: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the maximum of dE/dt over E, 1/s, with dp/dt = -diag(factors) L p, and its positions.

    dE/dt = -Re p* (I - Π) F L p and E are quadratic forms. The maximum is the greatest eigenvalue of the
    first where the second is 1, among errors from the shape.
    """
    basis = np.linalg.svd(np.stack([np.ones(ROBOTS), points], axis=1))[0][:, 2:]  # all but the similarities
    moved = -basis.conj().T @ (factors[:, None] * L) @ basis
    values, vectors = np.linalg.eigh(moved + moved.conj().T)
    return float(values[-1]), basis @ vectors[:, -1]


def rate(points: np.ndarray, p: np.ndarray, velocity: np.ndarray, weights: np.ndarray | float = 1.0) -> float:
    """Return dE/dt by central differences; for a quadratic form the only error is rounding, 1e-16 E / h."""
    h = 1e-4
    ahead, behind = (distance(points, p + sign * h * velocity, weights) for sign in (1, -1))
    return (ahead - behind) / (2 * h)


def test_individual_gains_need_constant_weights() -> None:
    """dp/dt = -diag(k_i) L p: with weights 1 / k_i dE/dt is still -2 V, and E alone may increase.

    Units' scales in pixels are such gains, and change as units take robots over. No weights then exist, and
    only Proposition 1 remains. With one gain for all robots E never increases.
    """
    rng = np.random.default_rng(4)
    rises = []
    for _ in range(30):
        points, p = cloud(rng, ROBOTS), cloud(rng, ROBOTS)
        L, gains = laplacian(points, tree_topology(rng, np.arange(ROBOTS))), rng.uniform(0.05, 1.0, ROBOTS)
        V = float(np.vdot(p, L @ p).real) / 2
        assert rate(points, p, -gains * (L @ p), 1 / gains) == pytest.approx(-2 * V, rel=1e-6, abs=1e-9)
        assert quickest_rise(points, L, np.full(ROBOTS, 0.5))[0] < 0
        fastest_ps, worst = quickest_rise(points, L, gains)
        assert rate(points, worst, -gains * (L @ worst)) == pytest.approx(fastest_ps / 2, abs=1e-6)
        rises.append(fastest_ps > 0)
    assert np.mean(rises) > 0.5


def test_misaligned_robots_can_increase_distance() -> None:
    """While robots turn, by less than 90 degrees off their goals, V falls and E may increase."""
    rng = np.random.default_rng(6)
    rises = []
    for _ in range(30):
        points = cloud(rng, ROBOTS)
        L = laplacian(points, tree_topology(rng, np.arange(ROBOTS)))
        turned = np.exp(1j * rng.uniform(-1.5, 1.5, ROBOTS))
        fastest_ps, worst = quickest_rise(points, L, turned)
        wish = -(L @ worst)
        assert np.vdot(-wish, turned * wish).real < 0, "V falls"
        rises.append(rate(points, worst, turned * wish) > 0)
        assert rises[-1] == (fastest_ps > 0)
    assert np.mean(rises) > 0.5
