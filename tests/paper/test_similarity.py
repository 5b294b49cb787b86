"""Similarity of Algorithm 1: exact, equivariant, equal to an independent least-squares solution."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from skyherd.control import Similarity, desired_points, fit_similarities, fit_similarity
from skyherd.errors import DegenerateSetError

TIGHT = 1e-10
"""Relative to the points' size: the fit divides by the template's spread, which the strategies keep above 1 %
of its size squared. A rounding of 1e-16 thus grows to at most 1e-12 for 12 points."""

coordinate = st.floats(-10, 10, allow_subnormal=False)
point = st.builds(complex, coordinate, coordinate)


def spread(points: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.abs(points - points.mean()) ** 2)))


@st.composite
def point_sets(draw: st.DrawFn, count: int | None = None) -> np.ndarray:
    size = count or draw(st.integers(2, 12))
    points = np.array(draw(st.lists(point, min_size=size, max_size=size)))
    assume(spread(points) > 0.1)
    return points


@st.composite
def two_sets(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    template = draw(point_sets())
    return template, draw(point_sets(count=template.size))


@st.composite
def similarities(draw: st.DrawFn) -> tuple[complex, complex]:
    """`z -> a z + b`, scales over six orders of magnitude."""
    scale = 10.0 ** draw(st.floats(-3, 3))
    return complex(scale * np.exp(1j * draw(st.floats(-np.pi, np.pi)))), draw(point)


suite = settings(max_examples=100)


@pytest.mark.smoke
@suite
@given(template=point_sets(), similarity=similarities())
def test_fit_recovers_exact_similarity(template, similarity) -> None:
    a, b = similarity
    current = a * template + b
    # A shift by b costs |b| / |a| of the points' digits.
    digits = TIGHT * (1 + abs(b) / abs(a))
    fit = fit_similarity(template, current)
    assert fit.factor == pytest.approx(a, rel=digits)
    assert fit.scale == pytest.approx(abs(a), rel=digits)
    assert np.exp(1j * fit.rotation_rad) == pytest.approx(a / abs(a), abs=digits)
    np.testing.assert_allclose(fit(template), current, rtol=0, atol=digits * abs(a) * 20)


@suite
@given(sets=two_sets())
def test_fit_agrees_with_linear_least_squares(sets) -> None:
    """The paper's linear system (proof of Property 1) in s cos phi, s sin phi and the translation."""
    template, current = sets
    rows = []
    for z in template:
        rows += [[z.real, -z.imag, 1, 0], [z.imag, z.real, 0, 1]]
    seen = np.column_stack([current.real, current.imag]).ravel()
    (c, s, tx, ty), *_ = scipy.linalg.lstsq(np.array(rows), seen)
    fit = fit_similarity(template, current)
    assert fit.factor == pytest.approx(complex(c, s), abs=TIGHT * 100)
    reference = complex(c, s) * template + complex(tx, ty)
    np.testing.assert_allclose(desired_points(template, current), reference, rtol=0, atol=TIGHT * 1000)


@suite
@given(sets=two_sets(), similarity=similarities())
def test_fit_is_equivariant_to_current_points(sets, similarity) -> None:
    """fit(T, G x) = G fit(T, x): the proof of Property 1."""
    (template, current), (a, b) = sets, similarity
    moved = desired_points(template, a * current + b)
    digits = TIGHT * (1 + abs(b) / abs(a))
    np.testing.assert_allclose(
        moved, a * desired_points(template, current) + b, rtol=0, atol=digits * abs(a) * 100
    )


@suite
@given(sets=two_sets(), similarity=similarities())
def test_fit_is_invariant_to_template_frame(sets, similarity) -> None:
    """fit(G T, x) (G T) = fit(T, x) (T): scale, rotation and origin of the template image are arbitrary."""
    (template, current), (a, b) = sets, similarity
    same = desired_points(a * template + b, current)
    digits = TIGHT * (1 + abs(b) / abs(a)) ** 2
    np.testing.assert_allclose(same, desired_points(template, current), rtol=0, atol=digits * 1000)


@suite
@given(sets=two_sets())
def test_desired_points_are_projection_with_same_centroid(sets) -> None:
    """Desired points are optimal: the residual is orthogonal to all similarities of T."""
    template, current = sets
    desired = desired_points(template, current)
    residual = current - desired
    assert desired.mean() == pytest.approx(current.mean(), abs=TIGHT)
    assert abs(residual.sum()) < TIGHT * 100
    assert abs(np.vdot(template, residual)) < TIGHT * 10_000
    assume(spread(desired) > 1e-3)
    np.testing.assert_allclose(desired_points(template, desired), desired, rtol=0, atol=TIGHT * 1000)


def test_similarity_call_matches_definition() -> None:
    similarity = Similarity(factor=2j, source=1 + 1j, target=5 + 0j)
    assert similarity.scale == 2
    assert similarity.rotation_rad == pytest.approx(np.pi / 2)
    np.testing.assert_array_equal(similarity(np.array([1 + 1j, 2 + 1j])), [5, 5 + 2j])


@pytest.mark.parametrize(
    ("template", "current"),
    [
        ([1 + 1j], [3 + 2j]),
        ([], []),
        ([1 + 1j, 1 + 1j, 1 + 1j], [0, 1, 2j]),
        ([0, 1, 2j], [400.3 + 7j] * 3),
        ([0.1 + 0.7j] * 3, [0, 1, 2j]),
        ([0, 1, 2j], [0j] * 3),
        ([0j] * 3, [0, 1, 2j]),
        ([0, 1], [0, 1, 2j]),
    ],
    ids=[
        "one point",
        "no point",
        "coincident template",
        "coincident current",
        "coincident up to rounding of the mean",
        "coincident at the origin",
        "template at the origin",
        "unequal numbers",
    ],
)
def test_fit_rejects_degenerate_sets(template, current) -> None:
    with pytest.raises(DegenerateSetError):
        fit_similarity(np.array(template, dtype=complex), np.array(current, dtype=complex))


def test_fit_similarities_equals_single_fits() -> None:
    """Groups of any size, in any order of points; those without a similarity have none, as in single fits.

    Both sum a few dozen products of numbers of order one, in other orders.
    """
    rng = np.random.default_rng(5)
    sizes = [7, 0, 1, 2, 40, 3, 3, 4]
    group = rng.permutation(np.repeat(np.arange(len(sizes)), sizes))
    template, current = (rng.normal(size=group.size) + 1j * rng.normal(size=group.size) for _ in range(2))
    template[group == 5] = 0.7 - 0.2j
    current[group == 6] = 3.0 + 1j
    square = np.array([1, 1j, -1, -1j])
    template[group == 7], current[group == 7] = square, square.conj()  # mirrored: explains nothing
    fits = fit_similarities(template, current, group=group, groups=len(sizes))
    assert fits.exist.tolist() == [True, False, False, True, True, False, False, False]
    for row in np.flatnonzero(fits.exist).tolist():
        alone = fit_similarity(template[group == row], current[group == row])
        there = fits(template, group)[group == row]
        np.testing.assert_allclose(there, alone(template[group == row]), rtol=0, atol=1e-13)
    for row in np.flatnonzero(~fits.exist).tolist():
        with pytest.raises(DegenerateSetError):
            fit_similarity(template[group == row], current[group == row])


def test_points_at_distances_near_zero_define_no_similarity() -> None:
    """The scale of such a fit is not finite, or its square is not."""
    current = np.array([100.0, 200.0 + 50j, 300j])
    for distance in (1e-60, 1e-150, 1e-200):
        near = distance * np.array([0, 1, 1j])
        with pytest.raises(DegenerateSetError), np.errstate(all="ignore"):
            fit_similarity(near, current)
        with np.errstate(all="ignore"):
            found = fit_similarities(near, current, group=np.zeros(3, dtype=np.int64), groups=1)
        assert not found.exist.any() and found.factors[0] == 0
