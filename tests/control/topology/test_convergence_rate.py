"""The linearised rate of a topology: closed form, null space, invariances, and the flow itself."""

from itertools import combinations

import numpy as np
import pytest
from scipy.linalg import expm

from skyherd.control import Template, motion_goals
from skyherd.control.topology.conditions import check_conditions
from skyherd.control.topology.convergence_rate import laplacian, pair_rates, slowest_rate
from skyherd.control.tree.pair_selection import stronger_pair
from skyherd.datasets import make_mission
from skyherd.datasets.generated.random_missions import Crowd, random_mission
from skyherd.geometry import wrap_angle
from skyherd.loop import run_steps

NO_ID = np.array([], dtype=np.int64)
FIRM, GAIN = 0.25, 1.25


def cloud(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.standard_normal(count) + 1j * rng.standard_normal(count)


def tree_sets(rng: np.random.Generator, units: int) -> list[np.ndarray]:
    """Return random sets on a random tree: each edge shares two robots that no other unit has."""
    sets, free, robots = [list(range(5))], [set(range(5))], 5
    for _ in range(1, units):
        parent = int(rng.choice([j for j in range(len(sets)) if len(free[j]) >= 2]))
        pair = rng.permutation(sorted(free[parent]))[:2].tolist()
        free[parent] -= set(pair)
        fresh = list(range(robots, robots + int(rng.integers(2, 6))))
        robots += len(fresh)
        sets.append(pair + fresh)
        free.append(set(fresh))
    return [np.sort(members) for members in sets]


@pytest.mark.parametrize(("tried", "least"), [(100, 300), pytest.param(300, 1000, marks=pytest.mark.slow)])
def test_pair_rates_equal_eigenvalue(tried, least) -> None:
    """`pair_rates` against `slowest_rate` on random sets.

    λ = 1 - sqrt(ρ), and ρ is the larger root of a quadratic. Where both roots meet it loses half the digits,
    1e-8. Elsewhere, with roots a gap g apart, the error is 1e-16 / g. The root of ρ itself divides by
    sqrt(ρ). Both are near one tenth for random sets and seldom under 1e-3, so that 1e-12 holds where they are
    not smaller.
    """
    rng = np.random.default_rng(1)
    compared = 0
    for _ in range(tried):
        common, ours, theirs = (int(rng.integers(low, 7)) for low in (2, 1, 1))
        count = common + ours + theirs
        points = rng.uniform(0.1, 100) * cloud(rng, count) + 50 * cloud(rng, 1)
        pairs = np.array([(a, b) for a in range(common) for b in range(a + 1, common)])
        fixed = np.r_[np.arange(common), np.arange(common + ours, count)]
        moving = np.arange(common, common + ours)
        rates = pair_rates(points, fixed, moving, pairs)
        for pair, rate in zip(pairs, rates, strict=True):
            expected = np.linalg.eigvalsh(laplacian(points, [fixed, np.r_[moving, pair]]))
            # the non-zero spectrum is 1 ± sqrt(ρ_1), 1 ± sqrt(ρ_2), and ones
            roots = np.sort((1 - expected[2:4]) ** 2)
            if roots[0] > 1e-3 and roots[1] - roots[0] > 1e-3:
                compared += 1
                assert rate == pytest.approx(expected[2], abs=1e-12)
            assert rate == pytest.approx(slowest_rate(points, [fixed, np.r_[moving, pair]]), abs=1e-7)
    assert compared > least


def test_pair_rates_of_lone_pair_equal_one() -> None:
    """A set of only a pair is always in shape: one projector of rate 1 remains."""
    points = cloud(np.random.default_rng(2), 6)
    rates = pair_rates(points, np.arange(6), NO_ID, np.array([[0, 1], [2, 5]]))
    np.testing.assert_allclose(rates, 1.0, atol=1e-7)


@pytest.mark.parametrize("units", [1, 2, 3, 5, 8])
def test_laplacian_null_space_is_similarities(units) -> None:
    """L vanishes on 1 and p' only: its rank is exactly two less than the robots, on random trees.

    Zero is rounding, N eps of a spectrum below 2; the third eigenvalue of these trees is above 1e-4.
    """
    rng = np.random.default_rng([3, units])
    for _ in range(20):
        sets = tree_sets(rng, units)
        count = 1 + max(int(members.max()) for members in sets)
        matrix = np.array([np.isin(np.arange(count), members) for members in sets])
        assert check_conditions(matrix).in_p
        points = cloud(rng, count)
        values = np.linalg.eigvalsh(laplacian(points, sets))
        assert np.abs(values[:2]).max() < 1e-13 * count
        assert values[2] > 1e-5
        similar = laplacian(points, sets) @ np.stack([np.ones(count), points], axis=1)
        assert np.abs(similar).max() < 1e-12


def test_one_shared_robot_gives_rate_zero() -> None:
    """Negative control: one part can rotate and scale about that robot, so L has one more zero."""
    points = cloud(np.random.default_rng(4), 8)
    sets = [np.arange(5), np.arange(4, 8)]
    assert slowest_rate(points, sets) < 1e-13
    assert slowest_rate(points, [np.arange(5), np.arange(3, 8)]) > 1e-3


def test_rate_is_invariant_to_similarity_of_template() -> None:
    """Template rotated, moved and scaled: equal to N eps times the loss by centring, |offset| / size."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        sets = tree_sets(rng, 4)
        points = cloud(rng, 1 + max(int(members.max()) for members in sets))
        moved = 30 * np.exp(2j) * points + (200 - 80j)
        assert slowest_rate(moved, sets) == pytest.approx(slowest_rate(points, sets), abs=1e-12)
        pairs = np.array([[0, 1], [1, 2]])
        ours, theirs = np.array([5]), np.arange(5)
        np.testing.assert_allclose(
            pair_rates(moved, theirs, ours, pairs), pair_rates(points, theirs, ours, pairs), atol=1e-7
        )


def test_rate_is_invariant_to_mirrored_template() -> None:
    """L becomes its conjugate."""
    rng = np.random.default_rng(6)
    sets = tree_sets(rng, 3)
    points = cloud(rng, 1 + max(int(members.max()) for members in sets))
    assert slowest_rate(points.conj(), sets) == pytest.approx(slowest_rate(points, sets), abs=1e-13)


def test_sum_of_goals_equals_minus_l_p(make_detections) -> None:
    """`motion_goals` of each unit in its own image, mapped to the ground and summed: exactly -L p.

    Cameras differ in scale, heading and position. Headings and bearings pass through angles, with a rounding
    of 1e-16 of the points' size, some thousand pixels.
    """
    rng = np.random.default_rng(7)
    for _ in range(20):
        sets = tree_sets(rng, 4)
        count = 1 + max(int(members.max()) for members in sets)
        template = Template(np.arange(count), 100 * cloud(rng, count))
        ground = cloud(rng, count)
        total = np.zeros(count, dtype=complex)
        for members in sets:
            scale = rng.uniform(50, 200) * np.exp(1j * rng.uniform(-3, 3))
            headings = rng.uniform(-3, 3, count)
            seen = make_detections(np.arange(count), scale * ground + 300, headings=headings)
            goals = motion_goals(seen, members, template, shared_ids=NO_ID, nearest=1)
            directions = wrap_angle(headings[members] - goals.bearings_rad)
            total[members] += goals.rho_px * np.exp(1j * directions) / scale
        flow = -laplacian(template.points_px, sets) @ ground
        np.testing.assert_allclose(total, flow, atol=1e-11)


def test_gradient_of_lyapunov_function_equals_l_p() -> None:
    """V = 1/2 p* L p; central differences of a quadratic are exact up to 1e-16 V / h."""
    rng = np.random.default_rng(8)
    sets = tree_sets(rng, 3)
    count = 1 + max(int(members.max()) for members in sets)
    matrix, p, h = laplacian(cloud(rng, count), sets), cloud(rng, count), 1e-3

    def v(at: np.ndarray) -> float:
        return float(np.vdot(at, matrix @ at).real) / 2

    for robot in range(count):
        nudge = h * (np.arange(count) == robot)
        slope = (v(p + nudge) - v(p - nudge)) / (2 * h)
        slope += 1j * (v(p + 1j * nudge) - v(p - 1j * nudge)) / (2 * h)
        assert slope == pytest.approx((matrix @ p)[robot], abs=1e-10)


@pytest.mark.smoke
def test_linear_flow_decays_at_slowest_rate() -> None:
    """exp(-L t) on random starts: the late shape error falls by exp(-λ_3) per unit of time.

    The next mode is smaller by exp(-(λ_4 - λ_3) t); t makes it 1e-6 of the first.
    """
    rng = np.random.default_rng(9)
    for _ in range(20):
        sets = tree_sets(rng, 3)
        points = cloud(rng, 1 + max(int(members.max()) for members in sets))
        matrix = laplacian(points, sets)
        values = np.linalg.eigvalsh(matrix)
        late = min(14 / (values[3] - values[2]), 20 / values[2])
        start = cloud(rng, points.size)
        basis = np.linalg.qr(np.stack([np.ones(points.size), points], axis=1))[0]

        def off_shape(t: float, matrix=matrix, start=start, basis=basis) -> float:
            now = expm(-t * matrix) @ start
            return float(np.linalg.norm(now - basis @ (basis.conj().T @ now)))

        fall = np.log(off_shape(late) / off_shape(late + 1 / values[2])) * values[2]
        behind = np.exp(-(values[3] - values[2]) * late)
        assert fall == pytest.approx(values[2], rel=max(100 * behind, 1e-6))


def test_stronger_pair_is_nearest_sufficient_or_strongest() -> None:
    """The reference is every pair's eigenvalue: units of 3 to 6 robots beside their pair."""
    rng, told = np.random.default_rng(5), {"none": 0, "firm": 0, "firmest": 0}
    for _ in range(200):
        mine, theirs = (int(count) for count in rng.integers(3, 7, 2))
        points = cloud(rng, mine + 2 + theirs)
        ours, there, pair = range(mine), range(mine, points.size), (mine, mine + 1)
        chosen = stronger_pair(
            Template(np.arange(points.size), points),
            frozenset(pair),
            candidates=frozenset(there) - frozenset(pair),
            theirs=frozenset(there),
            ours=frozenset(ours),
            firm=FIRM,
            gain=GAIN,
        )
        pairs = list(combinations(there, 2))
        rates = [slowest_rate(points, [np.array(there), np.array([*ours, *members])]) for members in pairs]
        middle = points[: mine + 2].mean()
        reach = [np.abs(points[list(members)] - middle).max() for members in pairs]
        now, enough = rates[pairs.index(pair)], min(FIRM, max(rates))
        better = [row for row, rate in enumerate(rates) if rate >= max(enough, GAIN * now)]
        kind = "none" if now >= FIRM or not better else "firm" if enough == FIRM else "firmest"
        expected = pairs[min(better, key=lambda row: reach[row])] if kind != "none" else ()
        told[kind] += 1
        assert chosen == frozenset(expected)
    assert min(told.values()) >= 10, told


@pytest.mark.parametrize("seed", [pytest.param(4, marks=pytest.mark.slow), 6])
def test_late_mission_error_decays_at_slowest_rate(seed) -> None:
    """Unicycles, two units with their own cameras, points without noise: the error falls as L predicts.

    Commands are held for a step of dt. Late, with aligned headings, each step multiplies the slowest mode by
    1 - k λ dt: a slope of -log(1 - k λ dt) / dt. Modes are orthogonal. The next one adds to the norm in
    quadrature, by exp(-2 k (λ_4 - λ_3) t) of its share at the last change of sets, t before. That share may
    start tenfold. The error itself, under 5e-4, enters the fit of the shape in second order.
    """
    tree = random_mission(seed, Crowd(2, 5))
    tree["perception"] = "ideal"
    mission = make_mission(tree)
    gain, step_s = mission.scenario.control.k, mission.scenario.step_s
    story, sets, since_s = [], {}, 0.0
    for step in run_steps(mission):
        now = {unit: members.tolist() for unit, members in step.control_sets.items()}
        if now != sets:
            sets, since_s, story = now, step.time_s, []
        error = step.metrics.shape.error
        if error < 5e-4:
            story.append((step.time_s, np.log(error)))
        if error < 1e-4:
            break
    rows = [np.searchsorted(mission.ids, members) for members in sets.values()]
    slowest, following = np.linalg.eigvalsh(laplacian(mission.template.points_px, rows))[2:4]
    times_s, logs = np.array(story).T
    assert len(times_s) > 20
    measured = -np.polyfit(times_s, logs, 1)[0]
    behind = np.exp(-2 * gain * (following - slowest) * (times_s[0] - since_s))
    assert behind < 1e-3, "the slowest mode is alone"
    assert measured == pytest.approx(-np.log(1 - gain * slowest * step_s) / step_s, rel=10 * behind + 1e-3)
