"""Evidence as a quadratic form, against least squares done directly."""

import numpy as np
import pytest

from skyherd.control.rectification.information import Information

N = 6
GROUPS = {"a": [0, 1], "b": [2], "c": [3, 4, 5]}


def lines(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Equations (20, 6) and values (20,)."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((20, N)), rng.standard_normal(20)


def evidence(seed: int) -> Information:
    a, y = lines(seed)
    return Information(a.T @ a, a.T @ y)


def chi_squared(seed: int, loose: list[int]) -> float:
    a, y = lines(seed)
    x = np.linalg.lstsq(a[:, loose], y, rcond=None)[0] if loose else np.zeros(0)
    return float(np.sum((y - a[:, loose] @ x) ** 2))


@pytest.mark.parametrize("loose", [[], [2], [0, 1, 5], [5, 0, 1], list(range(N))])
@pytest.mark.parametrize("seed", range(3))
def test_the_solution_is_that_of_least_squares_in_the_unknowns_let_loose(seed, loose):
    a, y = lines(seed)
    expected = np.zeros(N)
    if loose:
        expected[loose] = np.linalg.lstsq(a[:, loose], y, rcond=None)[0]
    np.testing.assert_allclose(evidence(seed).solved(loose), expected, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_evidence_of_two_images_adds_up(seed):
    (a, y), (b, z) = lines(seed), lines(seed + 10)
    both, stacked = evidence(seed) + evidence(seed + 10), np.vstack([a, b])
    expected = np.linalg.lstsq(stacked, np.concatenate([y, z]), rcond=None)[0]
    np.testing.assert_allclose(both.solved(range(N)), expected, atol=1e-12)
    np.testing.assert_allclose(both.all_loose()[1], np.linalg.inv(stacked.T @ stacked), atol=1e-12)


@pytest.mark.parametrize("count", [1, 4])
def test_what_is_told_of_some_is_the_marginal_of_all(count):
    """Of a Gaussian, the mean and covariance of some unknowns are parts of those of all."""
    all_, some = evidence(1), evidence(1).first(count)
    np.testing.assert_allclose(some.all_loose()[1], all_.all_loose()[1][:count, :count], atol=1e-12)
    np.testing.assert_allclose(some.solved(range(count)), all_.solved(range(N))[:count], atol=1e-12)


def test_loosened_evidence_keeps_its_mean_and_adds_the_variance():
    before, variances = evidence(2), np.array([0, 0, 1.0, 0, 2.0, 0])
    after = before.loosened(variances)
    np.testing.assert_allclose(after.solved(range(N)), before.solved(range(N)), atol=1e-12)
    np.testing.assert_allclose(after.all_loose()[1], before.all_loose()[1] + np.diag(variances), atol=1e-12)


def test_independent_unknowns_stand_beside_each_other():
    both = evidence(0).followed_by(Information.prior(np.array([0.5, 2.0])))
    np.testing.assert_allclose(both.all_loose()[1][:N, :N], evidence(0).all_loose()[1], atol=1e-12)
    np.testing.assert_allclose(np.diag(both.all_loose()[1])[N:], [0.25, 4.0])


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("least", [0.5, 2.0, 6.0])
def test_groups_earn_their_place_by_the_chi_squared_that_they_save(seed, least):
    """The greedy choice done over again with a fit for each question."""
    loose: list[int] = []
    waiting = dict(GROUPS)
    while waiting:
        falls = {n: chi_squared(seed, loose) - chi_squared(seed, loose + g) for n, g in waiting.items()}
        best = max(falls, key=lambda name: falls[name])
        if falls[best] < least:
            break
        loose += waiting.pop(best)
    assert sorted(evidence(seed).earned(GROUPS, {}, least)) == sorted(loose)


def test_a_group_waits_for_the_one_it_comes_after():
    """`b` would explain much, but says nothing without `a`, which explains nothing."""
    told = Information(np.eye(N), np.array([0, 0, 10.0, 0, 0, 0]))
    assert told.earned(GROUPS, {}, 20.0) == [2]
    assert told.earned(GROUPS, {"b": "a"}, 20.0) == []
