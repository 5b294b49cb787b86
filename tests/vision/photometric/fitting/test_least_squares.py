"""Least squares from Gram matrices, against NumPy's from the columns themselves."""

import numpy as np
import pytest
from tests.helpers.design_matrix_reference import PIXEL_ROW
from tests.helpers.fit_stages import stages
from tests.helpers.least_squares_reference import LeastSquaresSolution

from skyherd.vision.native.records import UNKNOWNS
from skyherd.vision.photometric.fitting.design_matrix import ANISOTROPY, BLACK, CONTRAST, GROUND, LIGHT, TONE
from skyherd.vision.photometric.fitting.fit import GROUND_RIDGE, MIN_CONTRAST, SINGLE_PRECISION

MARKERS, ROWS = 12, 300


def grown(solution, held, at):
    """Return the growth of the sum of squares where unknowns are held."""
    return solution.constrained(held, at).residual_squares - solution.residual_squares


HELD = [LIGHT, ANISOTROPY, [GROUND], [*ANISOTROPY, *LIGHT]]


@pytest.fixture(scope="module")
def problem():
    """Columns (N, 12, M), the first all ones, pixels (N, M) and their Gram matrices."""
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(MARKERS, UNKNOWNS, ROWS))
    columns[:, BLACK] = 1.0
    pixels = np.einsum("ni,nim->nm", rng.normal(size=(MARKERS, UNKNOWNS)), columns) + rng.normal(
        0, 0.5, (MARKERS, ROWS)
    )
    both = np.concatenate([columns, pixels[:, None]], axis=1)
    return columns, pixels, both @ both.transpose(0, 2, 1)


def solve(grams, pixels=ROWS):
    return LeastSquaresSolution.of_grams(grams, np.full(len(grams), float(pixels)))


def ridge_of(columns):
    """Return the ridge that is added to the squares of each column, (12,)."""
    ground = GROUND_RIDGE * np.equal(range(UNKNOWNS), GROUND)
    return SINGLE_PRECISION * ((columns**2).sum(axis=1) + ground) + ground


def least_squares(columns, pixels, held=(), at=()):
    """Unknowns and sum of squares by `np.linalg.lstsq`, those held moved to the pixels' side; what parts
    columns, and the ridge on the ground, are more rows."""
    design = np.concatenate([columns, np.diag(np.sqrt(ridge_of(columns)))], axis=1).T
    target = np.append(pixels, np.zeros(UNKNOWNS)) - design[:, list(held)] @ np.asarray(at)
    free = [i for i in range(UNKNOWNS) if i not in held]
    values, squares, rank, _ = np.linalg.lstsq(design[:, free], target, rcond=None)
    assert rank == len(free)
    whole = np.zeros(UNKNOWNS)
    whole[free], whole[list(held)] = values, at
    return whole, squares[0]


# The small ridge of 1e-9 on every unknown changes them by 1e-9 / 300 of themselves.


def test_solutions_are_those_of_least_squares(problem):
    columns, pixels, grams = problem
    solution = solve(grams)
    for row in range(MARKERS):
        values, squares = least_squares(columns[row], pixels[row])
        np.testing.assert_allclose(solution.values[row], values, atol=1e-8)
        assert solution.residual_squares[row] == pytest.approx(squares, rel=1e-8)
    np.testing.assert_allclose(solution.pixels, ROWS)
    np.testing.assert_allclose(solution.noise_stds(), np.sqrt(solution.residual_squares / (ROWS - UNKNOWNS)))
    assert solution.noise_stds().mean() == pytest.approx(0.5, rel=5 / np.sqrt(2 * MARKERS * ROWS))


@pytest.mark.parametrize("held", HELD, ids=str)
def test_holding_is_solving_without_those_columns(problem, held):
    columns, pixels, grams = problem
    at = np.random.default_rng(1).normal(size=(MARKERS, len(held)))
    solution = solve(grams).constrained(held, at)
    free = [i for i in range(UNKNOWNS) if i not in held]
    for row in range(MARKERS):
        values, squares = least_squares(columns[row], pixels[row], held, at[row])
        np.testing.assert_allclose(solution.values[row], values, atol=1e-8)
        assert solution.residual_squares[row] == pytest.approx(squares, rel=1e-8)
        normal = grams[row][np.ix_(free, free)]
        normal += np.diag(ridge_of(columns[row])[free])
        np.testing.assert_allclose(
            solution.inverse_normals[row][np.ix_(free, free)], np.linalg.inv(normal), atol=1e-10
        )
        np.testing.assert_allclose(solution.inverse_normals[row][held], 0, atol=1e-14)
    assert solution.free == len(free)


def test_holding_twice_is_holding_both(problem):
    _, _, grams = problem
    at = np.random.default_rng(2).normal(size=(MARKERS, 4))
    one = solve(grams).constrained(ANISOTROPY, at[:, :2]).constrained(LIGHT, at[:, 2:])
    both = solve(grams).constrained([*ANISOTROPY, *LIGHT], at)
    np.testing.assert_allclose(one.values, both.values, atol=1e-10)
    np.testing.assert_allclose(one.residual_squares, both.residual_squares, rtol=1e-10)
    assert one.free == both.free == UNKNOWNS - 4


@pytest.mark.parametrize("held", HELD, ids=str)
def test_growth_is_the_difference_of_the_squares(problem, held):
    columns, pixels, grams = problem
    at = np.random.default_rng(3).normal(size=(MARKERS, len(held)))
    growth = grown(solve(grams), held, at)
    for row in range(MARKERS):
        without, with_all = (
            least_squares(columns[row], pixels[row], held, at[row])[1],
            least_squares(columns[row], pixels[row])[1],
        )
        assert growth[row] == pytest.approx(without - with_all, rel=1e-7, abs=1e-7)


def test_noise_in_superfluous_unknowns_is_chi_squared():
    """Growth over the noise's variance has mean 2 for two unknowns: to 5 deviations of a mean of 400."""
    rng = np.random.default_rng(4)
    columns = rng.normal(size=(400, UNKNOWNS, ROWS))
    columns[:, BLACK] = 1.0
    pixels = rng.normal(0, 3.0, (400, 1, ROWS))
    both = np.concatenate([columns, pixels], axis=1)
    growth = grown(solve(both @ both.transpose(0, 2, 1)), LIGHT, np.zeros((400, 2)))
    assert (growth / 9.0).mean() == pytest.approx(2.0, abs=5 * 2 / np.sqrt(400))


@pytest.mark.parametrize("rows", [1, 3, 7, 11, 20])
def test_too_few_pixels_leave_no_negative_squares(rows):
    """Fewer pixels than unknowns, summed in single precision as the fit does: noise stays a real number."""
    rng = np.random.default_rng([5, rows])
    both = rng.normal(0, 100, (200, UNKNOWNS + 1, rows)).astype(np.float32)
    both[:, BLACK] = 1.0
    both[:, CONTRAST] = both[:, ANISOTROPY[0]]
    solution = solve((both @ both.transpose(0, 2, 1)).astype(float), rows)
    at = np.zeros((200, 2)), rng.normal(size=(200, 2))
    held = solution.constrained(LIGHT, at[0]).constrained(ANISOTROPY, at[1])
    drawn = compiled(compiled(solution, LIGHT, at[0], np.zeros(200)), ANISOTROPY, at[1], np.zeros(200))
    for some in (solution, held, drawn):
        assert (some.residual_squares > 0).all() and np.isfinite(some.noise_stds()).all()
    assert (grown(solution, [*LIGHT, *ANISOTROPY], np.ones((200, 4))) >= 0).all()


def test_a_marker_without_contrast_or_ground_is_still_solved():
    """Columns that are zero throughout make no singular matrix, and contrast is not divided by."""
    both = np.zeros((1, UNKNOWNS + 1, ROWS))
    both[:, BLACK], both[:, PIXEL_ROW] = 1.0, 7.0
    solution = solve(both @ both.transpose(0, 2, 1))
    assert (
        solution.values[0, BLACK] == pytest.approx(7.0, rel=2 * SINGLE_PRECISION)
        and abs(solution.values[0, CONTRAST]) < 1e-9
    )
    assert np.isfinite(solution.constrained(LIGHT, np.zeros((1, 2))).inverse_normals).all()
    assert solution.contrasts()[0] == MIN_CONTRAST


def compiled(solution, unknowns, at, variances):
    """Return the solution with one or two unknowns drawn by the compiled function."""
    parts = solution.values.copy(), solution.inverse_normals.copy(), solution.residual_squares.copy()
    stages().hold_unknowns(*parts, (unknowns[0], unknowns[-1]), at, variances)
    return LeastSquaresSolution(*parts, solution.pixels)


@pytest.mark.parametrize("unknowns", [LIGHT, ANISOTROPY, TONE], ids=str)
@pytest.mark.parametrize("variance", [0.0, 1e-3])
def test_compiled_function_draws_as_numpy(problem, unknowns, variance):
    _, _, grams = problem
    solution, at = solve(grams), np.random.default_rng(6).normal(size=(MARKERS, len(unknowns)))
    variances = np.full(MARKERS, variance)
    found, expected = (
        compiled(solution, unknowns, at, variances),
        solution.expected(unknowns, at, variances),
    )
    for name in ("values", "inverse_normals", "residual_squares"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-10, atol=1e-12)
    assert np.abs(found.values - solution.values).max() > 0.1
