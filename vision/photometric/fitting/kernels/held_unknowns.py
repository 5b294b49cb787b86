"""Least-squares solutions with one or two unknowns held, or expected at a value (`fitting.least_squares`)."""

from typing import Any

from numba import float64, int64, njit, void

from skyherd.jobs.compilation import FLAGS, readonly

_EACH, _VALUES, _MATRICES = readonly(float64, 1), readonly(float64, 2), readonly(float64, 3)


@njit(
    void(
        *(_VALUES, _MATRICES, _EACH, readonly(int64, 1), _VALUES, _EACH),
        *(float64[:, ::1], float64[:, :, ::1], float64[::1]),
    ),
    **FLAGS,
)
def draw(
    values: Any,
    inverse_normals: Any,
    squares: Any,
    unknowns: Any,
    at: Any,
    variances: Any,
    new_values: Any,
    new_inverse_normals: Any,
    new_squares: Any,
) -> None:
    """Draw unknowns h of N solutions towards values v: by `-C_xh B (x_h - v)`, with `B = (C_hh + P)⁻¹`.

    Args:
        values: (N, K) solutions x.
        inverse_normals: (N, K, K) C.
        squares: (N,) sums of squared residuals.
        unknowns: (1,) or (2,) indices h.
        at: (N, 1) or (N, 2) values v.
        variances: (N,) of each of them about its value, the diagonal of P; 0 holds them.
        new_values: (N, K) result.
        new_inverse_normals: (N, K, K) result: `C - C_xh B C_hx`.
        new_squares: (N,) result, raised by `(x_h - v)ᵀ B (x_h - v)`, which rounding does not make negative.
    """
    first, last = unknowns[0], unknowns[unknowns.size - 1]
    both = unknowns.size == 2
    for number in range(len(values)):
        c = inverse_normals[number]
        off_first, off_last = values[number, first] - at[number, 0], 0.0
        if both:
            off_last = values[number, last] - at[number, 1]
            top, bottom = c[first, first] + variances[number], c[last, last] + variances[number]
            determinant = top * bottom - c[first, last] * c[last, first]
            b_first, b_last = bottom / determinant, top / determinant
            b_both = -c[first, last] / determinant
        else:
            b_first, b_last, b_both = 1 / (c[first, first] + variances[number]), 0.0, 0.0
        pull_first = b_first * off_first + b_both * off_last
        pull_last = b_both * off_first + b_last * off_last
        new_squares[number] = squares[number] + max(off_first * pull_first + off_last * pull_last, 0.0)
        for row in range(values.shape[1]):
            new_values[number, row] = (
                values[number, row] - c[row, first] * pull_first - c[row, last] * pull_last
            )
            gain_first = c[row, first] * b_first + c[row, last] * b_both
            gain_last = c[row, first] * b_both + c[row, last] * b_last
            for column in range(values.shape[1]):
                drawn = gain_first * c[first, column] + gain_last * c[last, column]
                new_inverse_normals[number, row, column] = c[row, column] - drawn
