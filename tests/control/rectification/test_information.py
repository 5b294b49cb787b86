"""Information as a quadratic form, against direct least squares."""

import numpy as np
import pytest

from skyherd.control.rectification.information import Information

N = 6
GROUPS = {"a": [0, 1], "b": [2], "c": [3, 4, 5]}


def lines(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return equations (20, 6) and values (20,)."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((20, N)), rng.standard_normal(20)


def information(seed: int) -> Information:
    a, y = lines(seed)
    return Information(a.T @ a, a.T @ y)


def chi_squared(seed: int, free: list[int]) -> float:
    a, y = lines(seed)
    x = np.linalg.lstsq(a[:, free], y, rcond=None)[0] if free else np.zeros(0)
    return float(np.sum((y - a[:, free] @ x) ** 2))


@pytest.mark.parametrize("free", [[], [2], [0, 1, 5], [5, 0, 1], list(range(N))])
@pytest.mark.parametrize("seed", range(3))
def test_constrained_mean_equals_least_squares(seed, free):
    a, y = lines(seed)
    expected = np.zeros(N)
    if free:
        expected[free] = np.linalg.lstsq(a[:, free], y, rcond=None)[0]
    np.testing.assert_allclose(information(seed).constrained_mean(free), expected, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_information_of_two_images_is_additive(seed):
    (a, y), (b, z) = lines(seed), lines(seed + 10)
    both, stacked = information(seed) + information(seed + 10), np.vstack([a, b])
    expected = np.linalg.lstsq(stacked, np.concatenate([y, z]), rcond=None)[0]
    np.testing.assert_allclose(both.constrained_mean(range(N)), expected, atol=1e-12)
    np.testing.assert_allclose(both.estimate().covariance, np.linalg.inv(stacked.T @ stacked), atol=1e-12)


@pytest.mark.parametrize("count", [1, 4])
def test_marginal_equals_block_of_joint_estimate(count):
    """Mean and covariance of some unknowns of a Gaussian are parts of those of all."""
    all_, some = information(1), information(1).marginal(count)
    np.testing.assert_allclose(
        some.estimate().covariance, all_.estimate().covariance[:count, :count], atol=1e-12
    )
    np.testing.assert_allclose(
        some.constrained_mean(range(count)), all_.constrained_mean(range(N))[:count], atol=1e-12
    )


def test_diffused_information_keeps_mean_and_adds_variance():
    before, variances = information(2), np.array([0, 0, 1.0, 0, 2.0, 0])
    after = before.diffused(variances)
    np.testing.assert_allclose(
        after.constrained_mean(range(N)), before.constrained_mean(range(N)), atol=1e-12
    )
    np.testing.assert_allclose(
        after.estimate().covariance, before.estimate().covariance + np.diag(variances), atol=1e-12
    )


def test_joined_information_is_block_diagonal():
    both = information(0).joined(Information.prior(np.array([0.5, 2.0])))
    np.testing.assert_allclose(
        both.estimate().covariance[:N, :N], information(0).estimate().covariance, atol=1e-12
    )
    np.testing.assert_allclose(np.diag(both.estimate().covariance)[N:], [0.25, 4.0])


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("least", [0.5, 2.0, 6.0])
def test_significant_groups_match_greedy_chi_squared(seed, least):
    """The reference is the greedy choice with a separate fit for each question."""
    free: list[int] = []
    waiting = dict(GROUPS)
    while waiting:
        falls = {n: chi_squared(seed, free) - chi_squared(seed, free + g) for n, g in waiting.items()}
        best = max(falls, key=lambda name: falls[name])
        if falls[best] < least:
            break
        free += waiting.pop(best)
    assert sorted(information(seed).significant(GROUPS, after={}, threshold=least)) == sorted(free)


def test_significant_group_requires_its_predecessor():
    """`b` would explain much, but requires `a`, which explains nothing."""
    known = Information(np.eye(N), np.array([0, 0, 10.0, 0, 0, 0]))
    assert known.significant(GROUPS, after={}, threshold=20.0) == [2]
    assert known.significant(GROUPS, after={"b": "a"}, threshold=20.0) == []
